//! Meeting of the robot and a person: who comes to whom, and what the person gets to feel.

use crate::TAXELS;
use crate::bound;
use crate::closed_loop::{Loads, Rig, Row};
use crate::collision::{self, approach_m_s};
use crate::measure::{Measures, peak_force_n};
use crate::settings::Settings;
use anyhow::Result;
use moca_control::config::ProtectionConfig;
use moca_wbc::contact_barrier::STOP_SHARE;

/// A contact is watched for so long, s.
const WATCHED_S: f64 = 3.0;
/// A run that has met nobody by then never will, s.
const LONGEST_S: f64 = 12.0;
/// Period at which a run checks if it has seen enough, s.
const LOOK_S: f64 = 0.25;
/// Time that a hand takes to push with all its force: at once, its moment would throw the wrist, s.
const TAKES_HOLD_S: f64 = 0.5;

/// Kind of meeting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meeting {
    /// The flange is led, and the base goes into the person.
    Led,
    /// The person walks into the standing base.
    Walks,
    /// The person stands before it and leans on it, on purpose.
    Leans,
    /// A hand at the flange leads the robot in follow-me, and the base goes into the person.
    ByHand,
}

impl Meeting {
    /// Name in tables and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Led => "led",
            Self::Walks => "walks",
            Self::Leans => "leans",
            Self::ByHand => "by hand",
        }
    }

    /// Returns the force of a hand that leads the robot from `row` on: it takes hold, pushes as hard as eq. (2) needs for the speed
    /// of the settings, and turns the flange so that the base does not turn.
    fn hand(self, settings: &Settings, row: &Row) -> impl Fn(f64) -> Loads + use<> {
        let held_s = row.t_s;
        let pushed = if self == Self::ByHand { push(settings, row) } else { Loads::default() };
        move |t_s| pushed.scaled(((held_s + t_s) / TAKES_HOLD_S).min(1.0))
    }
}

fn push(settings: &Settings, row: &Row) -> Loads {
    let towards = collision::towards_person(settings);
    let damping = settings.config.control.gains.virtual_damping;
    let [x_n, y_n] = [0, 1].map(|axis| damping[axis] * towards[axis]);
    let [x_m, y_m] = [0, 1].map(|axis| row.flange_world[axis] - row.base_pose_world[axis]);
    Loads { flange_world: [x_n, y_n, 0.0, 0.0, 0.0, y_m * x_n - x_m * y_n], ..Loads::default() }
}

/// Result of one meeting, or of the worst of some.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Speed of cover and person towards each other just before the touch, m/s.
    pub approach_m_s: f64,
    /// Largest force within 0.1 s of the touch, N.
    pub first_touch_n: f64,
    /// Largest force within 0.5 s of the touch, N.
    pub impact_n: f64,
    /// Largest force, N.
    pub peak_n: f64,
    /// Time from the touch to the largest force, s.
    pub peak_after_s: f64,
    /// Time from the touch until the law bounds the base for it, s; NaN if it never does.
    pub noticed_after_s: f64,
    /// Time from the touch until the cover feels anything, s.
    pub felt_after_s: f64,
    /// Force that remains when the base does its utmost from that reading on, N.
    pub least_n: f64,
    /// Number of force peaks.
    pub taps: usize,
    /// A later peak is higher than the first of the same phase, and than the base itself may press.
    pub grows: bool,
    /// A later contact is harder than the first of the same phase: somebody was let go of in between.
    pub again: bool,
    /// Highest first peak, N.
    pub first_peak_n: f64,
    /// Highest later peak, N.
    pub later_n: f64,
    /// Largest distance of the flange from its target, mm.
    pub flange_mm: f64,
    /// Code of the fault that stopped the robot; empty without one.
    pub stopped: String,
}

impl Outcome {
    /// Lets somebody meet the robot as `meeting` says, `there` being cover, body and base as they are.
    ///
    /// # Errors
    /// Settings that [`Settings::check`] refuses, and a robot that is never armed.
    pub fn of(meeting: Meeting, there: &bound::Meeting, settings: &Settings) -> Result<Self> {
        let mut rig = Rig::start(settings, &settings.collision_scene()?)?;
        if meeting != Meeting::ByHand {
            rig.move_target(collision::towards_person(settings))?;
        }
        let touching = |row: &Row| row.total_force_n > 0.0;
        let mut first = None;
        loop {
            match rig.rows.last().map(|row| meeting.hand(settings, row)) {
                Some(hand) => rig.run_for(LOOK_S, hand)?,
                None => rig.run_for(LOOK_S, |_| Loads::default())?,
            }
            first = first.or_else(|| rig.rows.iter().position(touching));
            let seen_s =
                first.map_or(0.0, |first| rig.rows.last().map_or(0.0, |row| row.t_s) - rig.rows[first].t_s);
            if rig.stopped.is_some() || rig.sim_s > LONGEST_S || seen_s > WATCHED_S {
                break;
            }
        }
        let stopped = rig.stopped.as_deref().map_or("", |why| why.split(':').next().unwrap_or("stopped"));
        let stopped = stopped.to_owned();
        let Some(first) = first else { return Ok(Self { stopped, ..Self::default() }) };
        let rows = &rig.rows;
        let measures = Measures::of(rows, 1e-3);
        let since = |row: &Row| row.t_s - rows[first].t_s;
        let contact = &rows[first..];
        let most = contact.iter().max_by(|a, b| a.largest_force_n.total_cmp(&b.largest_force_n));
        let felt = contact.iter().find(|row| (0..TAXELS).any(|i| row.force_sensed[i] > 0.0));
        // a false alarm before the touch is none of it
        let alarmed = first == 0 || rows[first - 1].is_bounded;
        let noticed = contact.iter().find(|row| !alarmed && row.is_bounded).or(felt);
        let closing_m_s = approach_m_s(&rows[first.saturating_sub(1)], settings);
        let felt_after_s = felt.map_or(f64::NAN, since);
        let [first_peak_n, later_n] = first_and_later(&measures.peaks_n);
        let [first_contact_n, again_n] = first_and_later(&measures.contacts_n);
        Ok(Self {
            approach_m_s: closing_m_s,
            first_touch_n: measures.first_touch_n,
            impact_n: measures.impact_n,
            peak_n: peak_force_n(rows),
            peak_after_s: most.map_or(0.0, since),
            felt_after_s,
            noticed_after_s: noticed.map_or(f64::NAN, since),
            least_n: there.least_n(closing_m_s, felt_after_s),
            taps: measures.peaks_n.len(),
            grows: grows(first_peak_n, later_n),
            again: grows(first_contact_n, again_n),
            first_peak_n,
            later_n,
            flange_mm: measures.flange_max_mm,
            stopped,
        })
    }
}

/// Returns true if a later tap is harder than a first one, by more than 2 %, and than the base itself may press.
pub fn grows(first_peak_n: f64, later_n: f64) -> bool {
    later_n > 1.02 * first_peak_n.max(STOP_SHARE * ProtectionConfig::default().force_limit_n)
}

/// The first of some forces, and the largest of the others, N.
fn first_and_later(forces_n: &[f64]) -> [f64; 2] {
    let [first, later @ ..] = forces_n else { return [0.0; 2] };
    [*first, later.iter().copied().fold(0.0, f64::max)]
}
