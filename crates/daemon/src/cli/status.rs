//! The robot's status for people and programs. What is not known is null, never zero.

use crate::cli::report;
use moca_msgs::{
    ArmMode, Fault, GripperState, Law, Link, Mode, PostureOffset, Sample, TargetState, TaxelStatus, seconds,
};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::Commander;
use serde::{Serialize, Serializer};
use serde_json::{Value, json};
use std::fmt;

/// One sample as `mocad status --json` writes it.
#[derive(Debug, Serialize)]
pub(crate) struct Status {
    time_s: f64,
    mode: &'static str,
    fault: Option<FaultStatus>,
    law: Option<Law>,
    speed_limit_m_s: f64,
    speed_limit_reason: &'static str,
    /// Age of the cover's data, s; null before the first good frame.
    frame_age_s: Option<f64>,
    commander: &'static str,
    /// Null where there is no base, or its state is not known.
    base_pose_world: Option<BasePose>,
    /// Distance of the flange from where it is wanted; null where there is no arm, or no law to want it anywhere.
    flange_error_m: Option<f64>,
    /// Displacement of the base from where the arm's posture wants it; null unless the impedance law runs.
    posture: Option<PostureOffset>,
    /// The last target from another program; null where the law has had none.
    #[serde(serialize_with = "target")]
    target: Option<TargetState>,
    /// Null where there is none.
    #[serde(serialize_with = "gripper")]
    gripper: Option<GripperState>,
    /// Null of a simulated robot.
    link: Option<Link>,
    taxels: Vec<TaxelForce>,
}

#[derive(Debug, Serialize)]
struct FaultStatus {
    code: &'static str,
    text: String,
}

/// Kind and phase of a target by their names.
fn target<S: Serializer>(target: &Option<TargetState>, to: S) -> Result<S::Ok, S::Error> {
    let named = |TargetState { kind, phase, progress }| json!({ "kind": kind.name(), "phase": phase.name(), "progress": progress });
    target.map(named).serialize(to)
}

/// A gripper, its phase and fault by their names.
pub(super) fn gripper_json(state: &GripperState) -> Value {
    json!({
        "phase": state.phase.name(),
        "holding": state.is_holding(),
        "width_m": state.width_m,
        "width_max_m": state.width_max_m,
        "object_kg": state.object_kg,
        "fault": state.fault.map(|fault| json!({ "code": fault.code(), "text": fault.to_string() })),
    })
}

fn gripper<S: Serializer>(gripper: &Option<GripperState>, to: S) -> Result<S::Ok, S::Error> {
    gripper.as_ref().map(gripper_json).serialize(to)
}

#[derive(Debug, Serialize)]
struct BasePose {
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
}

#[derive(Debug, Serialize)]
struct TaxelForce {
    name: String,
    /// Null unless the status is "ok".
    force_n: Option<f64>,
    status: &'static str,
}

impl Status {
    pub(crate) fn new(robot: &RobotDescription, sample: &Sample, commander: Commander) -> Self {
        let unknown = matches!(
            sample.fault,
            Some(Fault::StateInvalid | Fault::PlantLost | Fault::ArmStale | Fault::BaseStale)
        );
        let (base, arm) = (robot.has_base(), robot.has_arm());
        let known = !unknown && sample.mode != Mode::Fault && (!arm || !sample.q_rad.is_empty());
        let [x_m, y_m, yaw_rad] = sample.base_pose_world;
        // In a brake no flange is computed: its orientation is then all zeros.
        let placed = sample.flange_quaternion_world.iter().any(|part| *part != 0.0);
        let force = |(i, taxel): (usize, &moca_msgs::TaxelReading)| TaxelForce {
            name: format!("T{}", i + 1),
            force_n: (taxel.status == TaxelStatus::Ok).then_some(taxel.force_n),
            status: taxel.status.name(),
        };
        Self {
            time_s: seconds(sample.time_ns),
            mode: sample.mode.name(),
            fault: sample.fault.map(|fault| FaultStatus { code: fault.code(), text: fault.to_string() }),
            law: sample.law,
            speed_limit_m_s: sample.speed_limit.m_s,
            speed_limit_reason: sample.speed_limit.reason.name(),
            frame_age_s: (sample.frame_age_s >= 0.0).then_some(sample.frame_age_s),
            commander: match commander {
                Commander::Nobody => "nobody",
                Commander::You => "this client",
                Commander::Another => "another client",
            },
            base_pose_world: (base && known).then_some(BasePose { x_m, y_m, yaw_rad }),
            flange_error_m: (arm && known && placed).then(|| sample.flange_error_m()),
            posture: sample.posture.filter(|_| known),
            target: sample.target,
            gripper: sample.gripper,
            link: sample.link,
            taxels: sample.taxels.iter().enumerate().map(force).collect(),
        }
    }

    /// One line of JSON.
    pub(crate) fn json(&self) -> String {
        // Text, numbers and lists: there is nothing in it that JSON could not hold.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known = |value: Option<String>| value.unwrap_or_else(|| "not known".into());
        let mode = self.fault.as_ref().map_or_else(String::new, |fault| format!(": {}", fault.text));
        writeln!(f, "mode         {}{mode}", self.mode)?;
        writeln!(f, "law          {}", known(self.law.map(|law| Mode::from(law).name().into())))?;
        writeln!(f, "speed limit  {:.3} m/s ({})", self.speed_limit_m_s, self.speed_limit_reason)?;
        writeln!(
            f,
            "frame age    {}",
            known(self.frame_age_s.map(|age_s| format!("{:.0} ms", 1e3 * age_s)))
        )?;
        writeln!(f, "commander    {}", self.commander)?;
        let pose = self.base_pose_world.as_ref();
        let pose = pose.map(|p| report::pose(&[p.x_m, p.y_m, p.yaw_rad]));
        writeln!(f, "base         {}", known(pose))?;
        let off = self.flange_error_m.map(|error_m| format!("off by {:.1} mm", 1e3 * error_m));
        writeln!(f, "flange       {}", known(off))?;
        if let Some(posture) = self.posture {
            let advised = posture.is_large() && !posture.recentring;
            let advice = if advised { ": `mocad recentre` brings it back" } else { "" };
            writeln!(f, "posture      base {posture}{advice}")?;
        }
        if let Some(TargetState { kind, phase, progress }) = self.target {
            writeln!(f, "target       {}: {}, {:.0} %", kind.name(), phase.name(), 100.0 * progress)?;
        }
        if let Some(gripper) = self.gripper {
            writeln!(f, "gripper      {gripper}")?;
        }
        if let Some(Link { arm_age_s, base_age_s, arm }) = self.link {
            let base_ms = 1e3 * base_age_s;
            if arm.mode == ArmMode::NotThere {
                writeln!(f, "link         base's state {base_ms:.0} ms old")?;
            } else {
                writeln!(f, "link         arm {arm}, states {:.0} and {base_ms:.0} ms old", 1e3 * arm_age_s)?;
            }
        }
        let forces = self.taxels.iter().map(|taxel| match taxel.force_n {
            Some(force_n) => format!("{} {force_n:.1} N", taxel.name),
            None => format!("{} {}", taxel.name, taxel.status),
        });
        writeln!(f, "cover        {}", forces.collect::<Vec<_>>().join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{ArmLink, TaxelReading};

    fn status(sample: &Sample) -> Status {
        Status::new(&RobotDescription::paper("test", true), sample, Commander::Nobody)
    }

    #[test]
    fn a_base_without_a_real_arm_shows_how_old_its_own_state_is() {
        let arm = ArmLink { mode: ArmMode::NotThere, ..ArmLink::default() };
        let link = Link { arm_age_s: 0.0, base_age_s: 0.034, arm };
        let shown = |link| status(&Sample { link: Some(link), ..Sample::default() }).to_string();
        assert!(shown(link).contains("link         base's state 34 ms old\n"), "{}", shown(link));
        let arm = ArmLink { mode: ArmMode::Torque, success_rate: 0.98, ..arm };
        let text = shown(Link { arm_age_s: 0.002, arm, ..link });
        assert!(
            text.contains("arm torque control, success rate 0.98") && text.contains("2 and 34 ms old"),
            "{text}"
        );
    }

    #[test]
    fn what_is_not_known_is_null_and_never_zero() {
        let reading = |force_n, status| TaxelReading { force_n, status };
        let taxels = [reading(0.0, TaxelStatus::Ok), reading(0.0, TaxelStatus::Dead)];
        let mut sample = Sample { frame_age_s: -1.0, ..Sample::default() };
        sample.taxels.extend(taxels);
        let unknown = status(&sample);
        assert!(unknown.frame_age_s.is_none() && unknown.flange_error_m.is_none());
        assert!(unknown.base_pose_world.is_none(), "no joint angles: the state did not pass its check");
        assert_eq!(unknown.taxels.iter().map(|taxel| taxel.force_n).collect::<Vec<_>>(), [Some(0.0), None]);
        assert!(unknown.json().contains(r#""frame_age_s":null"#), "{}", unknown.json());

        sample.q_rad.extend([0.0; 7]);
        sample.flange_quaternion_world = [0.0, 0.0, 0.0, 1.0];
        sample.flange_desired_position_world = [0.3, 0.4, 0.0];
        assert_eq!(status(&sample).flange_error_m, Some(0.5));
        assert!(status(&sample).base_pose_world.is_some());
        for fault in [Fault::PlantLost, Fault::StateInvalid, Fault::BaseStale] {
            assert!(status(&Sample { fault: Some(fault), ..sample.clone() }).base_pose_world.is_none());
        }
    }
}
