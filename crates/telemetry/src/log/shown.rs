//! A sample as records: rounded to what a picture can show.

use super::records::{Command, Cover, State, Timing, name_of, seven_digits};
use moca_msgs::{Mode, Sample};

/// A sample as a log shows it: its numbers with seven digits, the events of its contacts in full.
pub fn shown(sample: &Sample) -> Sample {
    let mut shown = sample.clone();
    let lists = [
        &mut shown.base_pose_world as &mut [f64],
        &mut shown.base_velocity_world,
        &mut shown.base_velocity_command_body,
        &mut shown.q_rad,
        &mut shown.dq_rad_s,
        &mut shown.arm_torque_nm,
        &mut shown.flange_position_world,
        &mut shown.flange_quaternion_world,
        &mut shown.flange_desired_position_world,
        &mut shown.flange_desired_quaternion_world,
        &mut shown.flange_wrench_world,
    ];
    let singles = [
        &mut shown.cover_speed_m_s,
        &mut shown.uncovered_way_m,
        &mut shown.frame_age_s,
        &mut shown.frame_rate_hz,
        &mut shown.speed_limit.m_s,
        &mut shown.lateness_s,
    ];
    let forces = shown.taxels.iter_mut().map(|taxel| &mut taxel.force_n);
    let link = shown
        .link
        .iter_mut()
        .flat_map(|link| [&mut link.arm_age_s, &mut link.base_age_s, &mut link.arm.success_rate]);
    let progress = shown.target.iter_mut().map(|target| &mut target.progress);
    let numbers = lists
        .into_iter()
        .flatten()
        .chain(&mut shown.cover_wrench_base)
        .chain(forces)
        .chain(singles)
        .chain(link)
        .chain(progress);
    numbers.for_each(|number| *number = seven_digits(*number));
    shown
}

impl From<&Sample> for State {
    fn from(sample: &Sample) -> Self {
        Self {
            tick: sample.tick,
            base_pose_world: sample.base_pose_world,
            base_velocity_world: sample.base_velocity_world,
            cover_speed_m_s: sample.cover_speed_m_s,
            uncovered_way_m: sample.uncovered_way_m,
            q_rad: sample.q_rad.to_vec(),
            dq_rad_s: sample.dq_rad_s.to_vec(),
            flange_position_world: sample.flange_position_world,
            flange_quaternion_world: sample.flange_quaternion_world,
            flange_desired_position_world: sample.flange_desired_position_world,
            flange_desired_quaternion_world: sample.flange_desired_quaternion_world,
            flange_wrench_world: sample.flange_wrench_world,
        }
    }
}

impl From<&Sample> for Command {
    fn from(sample: &Sample) -> Self {
        Self {
            tick: sample.tick,
            base_velocity_body: sample.base_velocity_command_body,
            arm_torque_nm: sample.arm_torque_nm.to_vec(),
            speed_limit_m_s: sample.speed_limit.m_s,
            speed_limit_reason: sample.speed_limit.reason,
            law: sample.law.map_or("", |law| Mode::from(law).name()).into(),
            contact_reaction: name_of(sample.contact_reaction),
        }
    }
}

impl From<&Sample> for Cover {
    fn from(sample: &Sample) -> Self {
        Self {
            tick: sample.tick,
            force_n: sample.taxels.iter().map(|t| t.force_n).collect(),
            status: sample.taxels.iter().map(|t| t.status).collect(),
            counts: sample.counts.to_vec(),
            wrench_base: sample.cover_wrench_base,
            frame_age_s: sample.frame_age_s,
            frame_rate_hz: sample.frame_rate_hz,
        }
    }
}

impl From<&Sample> for Timing {
    fn from(sample: &Sample) -> Self {
        Self {
            tick: sample.tick,
            lateness_s: sample.lateness_s,
            overruns: sample.overruns,
            stages_ns: sample.stages_ns,
            frames_good: sample.frames_good,
            frames_bad: sample.frames_bad,
        }
    }
}
