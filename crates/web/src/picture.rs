//! One picture for a page, little-endian. `page/src/picture.ts` reads it; the layout is tested here against that file's numbers.
//!
//! | byte | content |
//! |---|---|
//! | 0 | version, mode, law (255: unknown), flags: 1 live, 2 this page holds, 4 another holds, 8 gripper |
//! | 4 | `u32` number of the picture, `u32` newest message heard |
//! | 12 | `u16` time since that message, 0.1 ms; `u16` age of the newest picture drawn, ms; `u32` newest stop confirmed |
//! | 20 | `f64` loop time, s |
//! | 28 | taxels, joints, reason of the speed limit, 0 |
//! | 32 | `f32`: base pose (3), base velocity (3), cover speed, speed limit, cover age, cover rate, flange (3), joints, forces |
//! | … | status of each taxel |
//! | … | of a gripper: `f32` width, m, `f32` mass of the object, kg, phase |

use crate::look::Look;
use moca_msgs::{GripperPhase, Law, Mode, SpeedLimitReason, TaxelStatus};
use tokio::time::Instant;

/// Version of the layout.
const VERSION: u8 = 1;

/// Content of a picture that is of one page only.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Extras {
    pub(crate) number: u32,
    pub(crate) heard: u32,
    /// Time since the newest message, 0.1 ms.
    pub(crate) heard_before: u16,
    /// Age of the newest picture that the page has drawn, ms.
    pub(crate) drawn_age_ms: u16,
    /// Newest stop of this page that the daemon has carried out.
    pub(crate) stop_confirmed: u32,
    pub(crate) holder: HolderSeen,
}

/// The holder, as one page sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum HolderSeen {
    #[default]
    Nobody,
    ThisPage,
    Another,
}

/// A whole picture.
pub(crate) fn picture(look: &Look, force_n: &[f64], extras: &Extras, now: Instant) -> Vec<u8> {
    let sample = &look.sample;
    let holder = match extras.holder {
        HolderSeen::Nobody => 0,
        HolderSeen::ThisPage => 2,
        HolderSeen::Another => 4,
    };
    let flags = u8::from(look.is_fresh(now)) | holder | if sample.gripper.is_some() { 8 } else { 0 };
    let mut bytes = Vec::with_capacity(256);
    bytes.extend([VERSION, mode_number(sample.mode), sample.law.map_or(255, law_number), flags]);
    bytes.extend(extras.number.to_le_bytes());
    bytes.extend(extras.heard.to_le_bytes());
    bytes.extend(extras.heard_before.to_le_bytes());
    bytes.extend(extras.drawn_age_ms.to_le_bytes());
    bytes.extend(extras.stop_confirmed.to_le_bytes());
    bytes.extend(moca_msgs::seconds(sample.time_ns).to_le_bytes());
    let count = |length: usize| u8::try_from(length).unwrap_or(u8::MAX);
    bytes.extend([
        count(force_n.len()),
        count(sample.q_rad.len()),
        reason_number(sample.speed_limit.reason),
        0,
    ]);
    let numbers = sample
        .base_pose_world
        .iter()
        .chain(&sample.base_velocity_world)
        .chain([&sample.cover_speed_m_s, &sample.speed_limit.m_s, &sample.frame_age_s, &sample.frame_rate_hz])
        .chain(&sample.flange_position_world)
        .chain(&sample.q_rad)
        .chain(force_n);
    #[expect(clippy::cast_possible_truncation, reason = "shown with three digits")]
    let short = |number: f64| (number as f32).to_le_bytes();
    numbers.for_each(|number| bytes.extend(short(*number)));
    bytes.extend(sample.taxels.iter().map(|taxel| status_number(taxel.status)));
    if let Some(gripper) = &sample.gripper {
        bytes.extend(short(gripper.width_m));
        bytes.extend(short(gripper.object_kg));
        bytes.push(phase_number(gripper.phase));
    }
    bytes
}

const fn mode_number(mode: Mode) -> u8 {
    match mode {
        Mode::Starting => 0,
        Mode::Taring => 1,
        Mode::Ready => 2,
        Mode::Impedance => 3,
        Mode::FollowMe => 4,
        Mode::ProtectiveStop => 5,
        Mode::Fault => 6,
    }
}

const fn law_number(law: Law) -> u8 {
    match law {
        Law::Impedance => 0,
        Law::FollowMe => 1,
    }
}

const fn reason_number(reason: SpeedLimitReason) -> u8 {
    match reason {
        SpeedLimitReason::Configured => 0,
        SpeedLimitReason::BoardRate => 1,
        SpeedLimitReason::Stale => 2,
        SpeedLimitReason::Overridden => 3,
        SpeedLimitReason::Contact => 4,
        SpeedLimitReason::BaseLate => 5,
    }
}

const fn phase_number(phase: GripperPhase) -> u8 {
    match phase {
        GripperPhase::Resting => 0,
        GripperPhase::Moving => 1,
        GripperPhase::Holding => 2,
        GripperPhase::Unknown => 3,
    }
}

const fn status_number(status: TaxelStatus) -> u8 {
    match status {
        TaxelStatus::Ok => 0,
        TaxelStatus::NoZero => 1,
        TaxelStatus::Stale => 2,
        TaxelStatus::Saturated => 3,
        TaxelStatus::Stuck => 4,
        TaxelStatus::Dead => 5,
        TaxelStatus::Noisy => 6,
        TaxelStatus::Drifted => 7,
        TaxelStatus::Masked => 8,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = include_str!("../page/src/picture.ts");

    #[test]
    fn page_has_the_same_words_in_the_same_order() {
        let modes = [
            Mode::Starting,
            Mode::Taring,
            Mode::Ready,
            Mode::Impedance,
            Mode::FollowMe,
            Mode::ProtectiveStop,
            Mode::Fault,
        ];
        let statuses = [
            TaxelStatus::Ok,
            TaxelStatus::NoZero,
            TaxelStatus::Stale,
            TaxelStatus::Saturated,
            TaxelStatus::Stuck,
            TaxelStatus::Dead,
            TaxelStatus::Noisy,
            TaxelStatus::Drifted,
            TaxelStatus::Masked,
        ];
        let reasons = [
            SpeedLimitReason::Configured,
            SpeedLimitReason::BoardRate,
            SpeedLimitReason::Stale,
            SpeedLimitReason::Overridden,
            SpeedLimitReason::Contact,
            SpeedLimitReason::BaseLate,
        ];
        let phases =
            [GripperPhase::Resting, GripperPhase::Moving, GripperPhase::Holding, GripperPhase::Unknown];
        let list = |name: &str, words: &[&str]| {
            let words: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
            format!("{name} = [{}]", words.join(", "))
        };
        for wanted in [
            list("MODES", &modes.map(Mode::name)),
            list("STATUSES", &statuses.map(TaxelStatus::name)),
            list("REASONS", &reasons.map(SpeedLimitReason::name)),
            list("PHASES", &phases.map(GripperPhase::name)),
        ] {
            assert!(PAGE.contains(&wanted), "page/src/picture.ts lacks {wanted}");
        }
        assert_eq!(modes.map(mode_number), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(statuses.map(status_number), [0, 1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(reasons.map(reason_number), [0, 1, 2, 3, 4, 5]);
        assert_eq!(phases.map(phase_number), [0, 1, 2, 3]);
    }

    #[test]
    fn picture_of_the_papers_robot_at_30_hz_is_below_8_kb_a_second() {
        let mut look = Look::default();
        look.sample.q_rad.extend([0.0; 7]);
        look.sample.taxels.extend([moca_msgs::TaxelReading::default(); 11]);
        let (_, force_n) = look.force_since(0);
        let bytes = picture(&look, &force_n, &Extras::default(), Instant::now());
        assert_eq!(bytes.len(), 32 + 4 * (13 + 7 + 11) + 11);
        assert!(bytes.len() * 30 < 8000);
        assert_eq!(bytes[3], 0, "neither live, nor held, nor with a gripper");
        let phase = GripperPhase::Holding;
        look.sample.gripper =
            Some(moca_msgs::GripperState { width_m: 0.05, object_kg: 0.5, phase, ..Default::default() });
        let with_gripper = picture(&look, &force_n, &Extras::default(), Instant::now());
        let mut appended = [0.05_f32, 0.5].map(f32::to_le_bytes).concat();
        appended.push(2);
        assert_eq!((with_gripper[3], &with_gripper[bytes.len()..]), (8, appended.as_slice()));
        assert!(with_gripper.len() * 30 < 8000);
    }
}
