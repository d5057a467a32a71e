//! Messages for ROS users on top of what every viewer is shown: taxel forces with validity and age, the flange's
//! wrench, the gripper, diagnostics. Frames are those of the robot's URDF.

use crate::messages::{
    DiagnosticArray, DiagnosticStatus, Float64MultiArray, Header, JointState, KeyValue, MultiArrayDimension,
    MultiArrayLayout, Time, Vector3, Wrench, WrenchStamped,
};
use moca_msgs::{GripperFault, GripperPhase, GripperState, Mode, Sample, TaxelStatus, seconds};
use std::collections::VecDeque;

/// Columns of [`taxels`].
pub const TAXEL_COLUMNS: u32 = 3;
/// Names of the gripper's joints.
const FINGERS: [&str; 2] = ["finger_joint1", "finger_joint2"];
/// Time over which the fingers' velocity is taken, ns: a gripper reports less often than it is shown.
const RATE_NS: u64 = 100_000_000;
/// Levels of diagnostics.
const OK: u8 = 0;
const WARNING: u8 = 1;
const ERROR: u8 = 2;

/// One row for each taxel, T1 first: force, N; 1 if it is valid, else 0; age, s. A force that is not valid is NaN, and so is
/// an age before the first frame: stale is not zero.
pub fn taxels(sample: &Sample) -> Float64MultiArray {
    let count = u32::try_from(sample.taxels.len()).unwrap_or(u32::MAX);
    let age_s = if sample.frame_age_s < 0.0 { f64::NAN } else { sample.frame_age_s };
    let rows = sample.taxels.iter().flat_map(|taxel| {
        let valid = taxel.status == TaxelStatus::Ok;
        [if valid { taxel.force_n } else { f64::NAN }, f64::from(u8::from(valid)), age_s]
    });
    let dimension = |label: &str, size, stride| MultiArrayDimension { label: label.into(), size, stride };
    let dim = vec![
        dimension("taxel", count, count.saturating_mul(TAXEL_COLUMNS)),
        dimension("force_n valid age_s", TAXEL_COLUMNS, TAXEL_COLUMNS),
    ];
    Float64MultiArray { layout: MultiArrayLayout { dim, data_offset: 0 }, data: rows.collect() }
}

/// The external wrench on the robot about the flange's origin, in the flange's axes.
pub fn flange_wrench(sample: &Sample, stamp: Time) -> WrenchStamped {
    let [fx, fy, fz, mx, my, mz] = sample.flange_wrench_world;
    let [x, y, z, w] = sample.flange_quaternion_world;
    // World axes into the flange's: the turn back.
    let turn = |v: [f64; 3]| Vector3::from(turned([-x, -y, -z, w], v));
    let wrench = Wrench { force: turn([fx, fy, fz]), torque: turn([mx, my, mz]) };
    WrenchStamped { header: Header { stamp, frame_id: "flange".into() }, wrench }
}

/// The fingers as two joints, by the latest widths between them.
#[derive(Debug, Default)]
pub struct Fingers(VecDeque<(u64, f64)>);

impl Fingers {
    /// Adds the width at `now_ns` and returns the joints. Each has half of it, m. Its velocity, m/s, is the mean over
    /// 0.1 s; none in the first message. A gripper that does not answer has no joints.
    pub fn after(&mut self, now_ns: u64, state: &GripperState, stamp: Time) -> Option<JointState> {
        if state.phase == GripperPhase::Unknown {
            self.0.clear();
            return None;
        }
        self.0.push_back((now_ns, state.width_m));
        while self.0.front().is_some_and(|(then_ns, _)| then_ns + RATE_NS < now_ns) {
            self.0.pop_front();
        }
        let rate_m_s = self.0.front().and_then(|(then_ns, then_m)| {
            let passed_s = seconds(now_ns.saturating_sub(*then_ns));
            (passed_s > 0.0).then(|| (state.width_m - then_m) / passed_s)
        });
        Some(JointState {
            header: Header { stamp, frame_id: String::new() },
            name: FINGERS.map(Into::into).to_vec(),
            position: vec![0.5 * state.width_m; FINGERS.len()],
            velocity: rate_m_s.map_or_else(Vec::new, |rate_m_s| vec![0.5 * rate_m_s; FINGERS.len()]),
            effort: Vec::new(),
        })
    }
}

/// State of the gripper of the robot `name`. A fault is a warning with its remedy; a gripper that does not answer is an error.
pub fn gripper(name: &str, state: &GripperState) -> DiagnosticStatus {
    let level = match state.fault {
        _ if state.phase == GripperPhase::Unknown => ERROR,
        Some(_) => WARNING,
        None => OK,
    };
    let values = vec![
        value("phase", state.phase.name().into()),
        value("holds", state.is_holding().to_string()),
        value("object, kg", state.object_kg.to_string()),
        value("width, m", state.width_m.to_string()),
        value("largest width, m", state.width_max_m.to_string()),
        value("fault", state.fault.map_or("", GripperFault::code).into()),
    ];
    let text = state.fault.map_or_else(String::new, |fault| fault.to_string());
    status(name, "gripper", level, text, values)
}

fn value(key: &str, value: String) -> KeyValue {
    KeyValue { key: key.into(), value }
}

/// Status of a part of the robot `name`.
fn status(name: &str, part: &str, level: u8, message: String, values: Vec<KeyValue>) -> DiagnosticStatus {
    DiagnosticStatus { level, name: format!("moca: {part}"), message, hardware_id: name.into(), values }
}

/// Supervisor, cover, gripper and loop.
pub fn diagnostics(name: &str, sample: &Sample, stamp: Time) -> DiagnosticArray {
    let status = |part: &str, level, message, values| status(name, part, level, message, values);
    let robot = match sample.fault {
        Some(fault) => {
            let text = format!("{} {}", fault.text(), fault.remedy());
            (ERROR, text, vec![value("fault", fault.code().into())])
        }
        None => (if sample.mode == Mode::Starting { WARNING } else { OK }, String::new(), Vec::new()),
    };
    let (level, text, mut values) = robot;
    values.push(value("mode", sample.mode.name().into()));
    values.push(value("speed limit, m/s", sample.speed_limit.m_s.to_string()));
    let mut parts = vec![status("robot", level, text, values)];
    if !sample.taxels.is_empty() {
        let bad = sample.taxels.iter().filter(|taxel| taxel.status != TaxelStatus::Ok).count();
        let values = vec![
            value("taxels not valid", bad.to_string()),
            value("frame age, s", sample.frame_age_s.to_string()),
            value("frame rate, Hz", sample.frame_rate_hz.to_string()),
            value("frames rejected", sample.frames_bad.to_string()),
        ];
        let level = if bad > 0 || sample.frame_age_s < 0.0 { ERROR } else { OK };
        parts.push(status("cover", level, sample.board.text().into(), values));
    }
    parts.extend(sample.gripper.as_ref().map(|state| gripper(name, state)));
    let values = vec![
        value("slots missed", sample.overruns.to_string()),
        value("lateness, s", sample.lateness_s.to_string()),
    ];
    parts.push(status("loop", OK, String::new(), values));
    DiagnosticArray { header: Header { stamp, frame_id: String::new() }, status: parts }
}

/// `v` turned by a unit quaternion: v + 2·u × (u × v + w·v).
fn turned([x, y, z, w]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let u = [x, y, z];
    let inner: [f64; 3] = {
        let c = cross(u, v);
        std::array::from_fn(|i| c[i] + w * v[i])
    };
    let outer = cross(u, inner);
    std::array::from_fn(|i| v[i] + 2.0 * outer[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{Fault, TaxelReading};

    #[test]
    fn a_force_that_is_not_valid_is_not_a_number_and_says_so() {
        let mut sample = Sample { frame_age_s: 0.02, ..Sample::default() };
        sample.taxels.push(TaxelReading { force_n: 12.0, status: TaxelStatus::Ok }).unwrap();
        sample.taxels.push(TaxelReading { force_n: 0.0, status: TaxelStatus::Stale }).unwrap();
        let message = taxels(&sample);
        assert_eq!(message.data[..3], [12.0, 1.0, 0.02]);
        assert!(message.data[3].is_nan() && message.data[4..] == [0.0, 0.02]);
        let sizes: Vec<_> = message.layout.dim.iter().map(|dim| (dim.size, dim.stride)).collect();
        assert_eq!(sizes, [(2, 6), (3, 3)]);
        let cover = &diagnostics("lab", &sample, Time::default()).status[1];
        assert_eq!((cover.level, cover.values[0].value.as_str()), (ERROR, "1"));
        sample.frame_age_s = -1.0;
        assert!(taxels(&sample).data[2].is_nan(), "no frame yet");
    }

    #[test]
    fn the_wrench_is_in_the_axes_of_the_frame_it_names() {
        let half = std::f64::consts::FRAC_PI_4;
        let sample = Sample {
            flange_wrench_world: [0.0, 5.0, 0.0, 1.0, 0.0, 0.0],
            flange_quaternion_world: [0.0, 0.0, half.sin(), half.cos()],
            ..Sample::default()
        };
        let WrenchStamped { header, wrench } = flange_wrench(&sample, Time::default());
        assert_eq!(header.frame_id, "flange");
        let near =
            |v: Vector3, wanted: [f64; 3]| v.array().iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(wrench.force, [5.0, 0.0, 0.0]) && near(wrench.torque, [0.0, -1.0, 0.0]));
    }

    fn moving(width_m: f64) -> GripperState {
        GripperState { width_m, width_max_m: 0.08, phase: GripperPhase::Moving, ..GripperState::default() }
    }

    #[test]
    fn fingers_have_half_the_width_and_its_rate() {
        let mut fingers = Fingers::default();
        let first = fingers.after(0, &moving(0.08), Time::default()).unwrap();
        assert_eq!(first.name, ["finger_joint1", "finger_joint2"]);
        assert_eq!((first.position, first.velocity), (vec![0.04; 2], vec![]), "one width has no rate");
        // The gripper reports every second message; the rate is that of the motion all the same.
        let mut velocity = vec![];
        for tick in 1..=30_u32 {
            let state = moving(0.08 - 1e-3 * f64::from(tick / 2));
            velocity = fingers.after(u64::from(tick) * 10_000_000, &state, Time::default()).unwrap().velocity;
        }
        assert!(velocity.len() == 2 && velocity.iter().all(|v| (v + 0.025).abs() < 1e-9), "{velocity:?}");
        let silent = GripperState { phase: GripperPhase::Unknown, ..moving(0.065) };
        assert_eq!(fingers.after(310_000_000, &silent, Time::default()), None);
        let again = fingers.after(320_000_000, &moving(0.0), Time::default()).unwrap();
        assert!(again.velocity.is_empty(), "from before it was silent");
        let late = fingers.after(500_000_000, &moving(0.08), Time::default()).unwrap();
        assert!(late.velocity.is_empty(), "too long ago");
    }

    #[test]
    fn gripper_tells_phase_object_and_fault_with_its_remedy() {
        let held = GripperState { phase: GripperPhase::Holding, object_kg: 0.5, ..moving(0.05) };
        let said = gripper("lab", &held);
        let values: Vec<_> = said.values.iter().map(|one| (one.key.as_str(), one.value.as_str())).collect();
        assert_eq!(
            values,
            [
                ("phase", "holding"),
                ("holds", "true"),
                ("object, kg", "0.5"),
                ("width, m", "0.05"),
                ("largest width, m", "0.08"),
                ("fault", ""),
            ]
        );
        assert_eq!((said.level, said.message.as_str(), said.hardware_id.as_str()), (OK, "", "lab"));
        let lost = GripperState { fault: Some(GripperFault::Lost), ..moving(0.01) };
        let silent =
            GripperState { phase: GripperPhase::Unknown, fault: Some(GripperFault::Unplugged), ..held };
        for (state, level, code) in [(lost, WARNING, "object-lost"), (silent, ERROR, "gripper-unplugged")] {
            let said = gripper("lab", &state);
            assert_eq!((said.level, said.values[5].value.as_str()), (level, code));
            assert_eq!(said.message, state.fault.unwrap().to_string());
            let sample = Sample { gripper: Some(state), ..Sample::default() };
            assert_eq!(diagnostics("lab", &sample, Time::default()).status[1], said);
        }
        assert_eq!(diagnostics("lab", &Sample::default(), Time::default()).status.len(), 2, "no gripper");
    }

    #[test]
    fn a_fault_is_an_error_with_its_code_and_what_to_do() {
        let sample =
            Sample { fault: Some(Fault::BaseStale), mode: Mode::ProtectiveStop, ..Sample::default() };
        let robot = &diagnostics("lab", &sample, Time::default()).status[0];
        assert_eq!((robot.level, robot.values[0].value.as_str()), (ERROR, "base-stale"));
        assert!(robot.message.contains(Fault::BaseStale.remedy()));
    }
}
