//! The numbers of a sample, each under a name with its frame where there are several, and its unit.

use moca_msgs::{Sample, TaxelStatus};
use moca_telemetry::RobotDescription;
use moca_wbc::rotation::Heading;

/// Which parts a run has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Parts {
    pub(super) joints: usize,
    pub(super) taxels: usize,
}

impl Parts {
    /// Those of a run; a robot without an arm is described with one all the same.
    pub(super) fn of(description: &RobotDescription, samples: &[Sample]) -> Self {
        let joints = samples.iter().map(|sample| sample.q_rad.len()).max().unwrap_or(0);
        Self { joints, taxels: description.taxels.len() }
    }
}

/// One number of a sample.
pub(super) struct Quantity {
    pub(super) name: String,
    value: Box<dyn Fn(&Sample) -> f64>,
}

impl Quantity {
    fn new(name: impl Into<String>, value: impl Fn(&Sample) -> f64 + 'static) -> Self {
        Self { name: name.into(), value: Box::new(value) }
    }

    /// Its value, NaN where there is none.
    pub(super) fn of(&self, sample: &Sample) -> f64 {
        (self.value)(sample)
    }
}

/// Elements of a list, one name each.
fn elements<const N: usize>(names: [&str; N], of: fn(&Sample) -> &[f64]) -> Vec<Quantity> {
    (0..).zip(names).map(|(i, name)| Quantity::new(name, move |s| element(of(s), i))).collect()
}

fn element(values: &[f64], i: usize) -> f64 {
    values.get(i).copied().unwrap_or(f64::NAN)
}

/// One of each joint, J1 first.
fn joints(parts: Parts, name: fn(usize) -> String, of: fn(&Sample) -> &[f64]) -> Vec<Quantity> {
    (0..parts.joints).map(|i| Quantity::new(name(i + 1), move |s| element(of(s), i))).collect()
}

/// Measured value of each quantity that an [`action`] commands, in its order: base velocity in the base's own axes, flange
/// pose in the world.
pub(super) fn state(parts: Parts) -> Vec<Quantity> {
    let velocity =
        |i: usize| move |s: &Sample| Heading::at(s.base_pose_world[2]).to_base(s.base_velocity_world)[i];
    let names = ["base_vx_body_m_s", "base_vy_body_m_s", "base_yaw_rate_rad_s"];
    let mut all: Vec<_> = (0..).zip(names).map(|(i, name)| Quantity::new(name, velocity(i))).collect();
    all.extend(flange(parts));
    all
}

/// Pose of the base in the world.
pub(super) fn base() -> Vec<Quantity> {
    elements(["base_x_m", "base_y_m", "base_yaw_rad"], |s| &s.base_pose_world)
}

/// Angles, then rates of the joints.
pub(super) fn joint_state(parts: Parts) -> Vec<Quantity> {
    let mut all = joints(parts, |i| format!("q{i}_rad"), |s| &s.q_rad);
    all.extend(joints(parts, |i| format!("dq{i}_rad_s"), |s| &s.dq_rad_s));
    all
}

/// Pose of the flange in the world; empty without an arm.
fn flange(parts: Parts) -> Vec<Quantity> {
    let mut all = Vec::new();
    if parts.joints > 0 {
        all.extend(elements(["flange_x_m", "flange_y_m", "flange_z_m"], |s| &s.flange_position_world));
        all.extend(elements(["flange_qx", "flange_qy", "flange_qz", "flange_qw"], |s| {
            &s.flange_quaternion_world
        }));
    }
    all
}

/// Commands that another controller could give: base velocity in the base's own axes, desired flange pose in
/// the world.
pub(super) fn action(parts: Parts) -> Vec<Quantity> {
    let mut all = elements(["base_vx_body_m_s", "base_vy_body_m_s", "base_yaw_rate_rad_s"], |s| {
        &s.base_velocity_command_body
    });
    if parts.joints > 0 {
        let place = ["flange_desired_x_m", "flange_desired_y_m", "flange_desired_z_m"];
        all.extend(elements(place, |s| &s.flange_desired_position_world));
        let turned = ["flange_desired_qx", "flange_desired_qy", "flange_desired_qz", "flange_desired_qw"];
        all.extend(elements(turned, |s| &s.flange_desired_quaternion_world));
    }
    all
}

/// Joint torques that were commanded, gravity included, N·m.
pub(super) fn torque(parts: Parts) -> Vec<Quantity> {
    joints(parts, |i| format!("torque{i}_nm"), |s| &s.arm_torque_nm)
}

/// Returns true if a taxel's force is valid.
pub(super) fn valid(sample: &Sample, taxel: usize) -> bool {
    sample.taxels.get(taxel).is_some_and(|t| t.status == TaxelStatus::Ok && t.force_n.is_finite())
}

/// Force of each taxel, N; NaN where it means nothing.
pub(super) fn forces(parts: Parts) -> Vec<Quantity> {
    let force = |i| move |s: &Sample| if valid(s, i) { s.taxels[i].force_n } else { f64::NAN };
    (0..parts.taxels).map(|i| Quantity::new(format!("t{}_n", i + 1), force(i))).collect()
}

/// Gives each quaternion the sign next to the one before it, and the first its largest element positive: both signs are one
/// orientation, and a jump from one to the other would be learned as a motion.
pub(super) fn join_quaternions(samples: &mut [Sample]) {
    let mut before: Option<[[f64; 4]; 2]> = None;
    for sample in samples {
        let now = [&mut sample.flange_quaternion_world, &mut sample.flange_desired_quaternion_world];
        for (i, quaternion) in now.into_iter().enumerate() {
            let likeness: f64 = match &before {
                Some(before) => before[i].iter().zip(&*quaternion).map(|(a, b)| a * b).sum(),
                None => quaternion.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0),
            };
            if likeness < 0.0 {
                *quaternion = quaternion.map(|element| -element);
            }
        }
        before = Some([sample.flange_quaternion_world, sample.flange_desired_quaternion_world]);
    }
}

/// Everything that a table has.
pub(super) fn all(parts: Parts) -> Vec<Quantity> {
    let mut all = base();
    all.extend(elements(["base_vx_m_s", "base_vy_m_s", "base_yaw_rate_rad_s"], |s| &s.base_velocity_world));
    all.extend(joint_state(parts));
    all.extend(flange(parts));
    let commands = action(parts).into_iter();
    all.extend(commands.map(|q| Quantity { name: format!("command_{}", q.name), ..q }));
    all.extend(torque(parts));
    if parts.joints > 0 {
        let wrench =
            ["flange_fx_n", "flange_fy_n", "flange_fz_n", "flange_mx_nm", "flange_my_nm", "flange_mz_nm"];
        all.extend(elements(wrench, |s| &s.flange_wrench_world));
    }
    all.extend(forces(parts));
    let counts = |i: usize| move |s: &Sample| s.counts.get(i).map_or(f64::NAN, |count| f64::from(*count));
    all.extend((0..parts.taxels).map(|i| Quantity::new(format!("t{}_counts", i + 1), counts(i))));
    all.extend(elements(["cover_fx_n", "cover_fy_n", "cover_mz_nm"], |s| &s.cover_wrench_base));
    all.push(Quantity::new("cover_age_s", |s| s.frame_age_s));
    all.push(Quantity::new("cover_rate_hz", |s| s.frame_rate_hz));
    all.push(Quantity::new("cover_speed_m_s", |s| s.cover_speed_m_s));
    all.push(Quantity::new("speed_limit_m_s", |s| s.speed_limit.m_s));
    all.push(Quantity::new("lateness_s", |s| s.lateness_s));
    all
}
