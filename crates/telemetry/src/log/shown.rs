//! A sample as records: rounded to what a picture can show.

use super::records::{Command, Cover, State, Timing, seven_digits};
use moca_msgs::Sample;

/// A sample as a log shows it: its numbers with seven digits, the events of its contacts in full.
pub fn shown(sample: &Sample) -> Sample {
    // A log holds no displacement of the posture: a replay computes it.
    let mut shown = Sample { posture: None, ..sample.clone() };
    State::shorten(&mut shown);
    Command::shorten(&mut shown);
    Cover::shorten(&mut shown);
    Timing::shorten(&mut shown);
    if let Some(link) = &mut shown.link {
        for number in [&mut link.arm_age_s, &mut link.base_age_s, &mut link.arm.success_rate] {
            *number = seven_digits(*number);
        }
    }
    if let Some(target) = &mut shown.target {
        target.progress = seven_digits(target.progress);
    }
    if let Some(gripper) = &mut shown.gripper {
        gripper.width_m = seven_digits(gripper.width_m);
        gripper.width_max_m = seven_digits(gripper.width_max_m);
    }
    shown
}
