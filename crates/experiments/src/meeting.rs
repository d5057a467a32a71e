//! Meeting of the robot and a person: who comes to whom, and what the person gets to feel.

use crate::TAXELS;
use crate::bound;
use crate::closed_loop::{Flight, Loads, Rig, Row};
use crate::collision::{self, approach_m_s};
use crate::measure::{Measures, peak_force_n};
use crate::settings::Settings;
use anyhow::Result;
use moca_control::config::ProtectionConfig;
use moca_wbc::contact_barrier::{RETREAT_M_S, STOP_SHARE};
use moca_wbc::cover_map::CoverMap;

/// Usual time for which a contact is watched, s.
pub const WATCHED_S: f64 = 3.0;
/// Time by which the two have met, or never will, s.
const MEETS_S: f64 = 9.0;
/// Longest time that a base which flees takes to be away, s.
const ESCAPES_S: f64 = 3.0;
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

    /// Lets the two meet, with `flight` of the base from its row on, and watches for `watched_s` from the touch on: what happened, and
    /// the row of the touch. It ends with the first contact if the base flees.
    fn watched(
        self,
        settings: &Settings,
        flight: Option<Flight>,
        watched_s: f64,
    ) -> Result<(Rig, Option<usize>)> {
        let mut rig = Rig::start(settings, &settings.collision_scene()?)?;
        rig.flight = flight;
        if self != Self::ByHand {
            rig.move_target(collision::towards_person(settings))?;
        }
        let mut first = None;
        loop {
            match rig.rows.last().map(|row| self.hand(settings, row)) {
                Some(hand) => rig.run_for(LOOK_S, hand)?,
                None => rig.run_unloaded_for(LOOK_S)?,
            }
            first = first.or_else(|| rig.rows.iter().position(|row| row.total_force_n > 0.0));
            let seen_s =
                first.map_or(0.0, |first| rig.rows.last().map_or(0.0, |row| row.t_s) - rig.rows[first].t_s);
            let fled = flight.is_some_and(|flight| {
                rig.rows.get(flight.row..).is_some_and(|rows| rows.iter().any(|row| row.total_force_n <= 0.0))
            });
            if rig.stopped.is_some() || rig.sim_s > MEETS_S + watched_s || seen_s > watched_s || fled {
                return Ok((rig, first));
            }
        }
    }

    /// Force on the person by a law that knew at once what comes, N, a measure of the least and no proof of it: the same meeting again,
    /// but from the first alarm on the base goes away along the wrench of its taxels' forces as fast as its orders may change, with and
    /// without turning, up to the fastest retreat of the contact barrier. Orders are as late as they were.
    ///
    /// # Errors
    /// As [`Outcome::of`].
    pub fn least_of_any_law_n(self, settings: &Settings, alarm: &Alarm) -> Result<f64> {
        let limits = &settings.config.limits;
        let mut least_n = f64::INFINITY;
        for turns in [true, false] {
            let flight = Flight {
                row: alarm.row,
                wrench_base: alarm.wrench_base,
                turns,
                acceleration: limits.base_acceleration,
                fastest: limits.base_velocity,
                retreat_m_s: RETREAT_M_S,
            };
            least_n = least_n.min(self.fleeing_n(settings, flight)?);
        }
        Ok(least_n)
    }

    /// Largest force before the base that flees is let go of, N.
    pub(crate) fn fleeing_n(self, settings: &Settings, flight: Flight) -> Result<f64> {
        let row = flight.row;
        let (rig, _) = self.watched(settings, Some(flight), ESCAPES_S)?;
        let released = rig.rows[row..].iter().position(|row| row.total_force_n <= 0.0);
        Ok(peak_force_n(&rig.rows[..released.map_or(rig.rows.len(), |rows| row + rows)]))
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

/// First alarm about a touch.
#[derive(Clone, Copy, Debug)]
pub struct Alarm {
    /// Its row.
    pub row: usize,
    /// Wrench of the taxels' true forces by then, each at its taxel's place, axes and origin of B: N, N, N·m. Where on a plate somebody
    /// presses no taxel shows.
    pub wrench_base: [f64; 3],
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
    /// Time from the touch to the first alarm, s; NaN without one.
    pub noticed_after_s: f64,
    /// That alarm.
    pub alarm: Option<Alarm>,
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
    /// Lets somebody meet the robot as `meeting` says, `there` being cover, body and base as they are, and watches for `watched_s` from
    /// the touch on.
    ///
    /// # Errors
    /// Settings that [`Settings::check`] refuses, and a robot that is never armed.
    pub fn of(meeting: Meeting, there: &bound::Meeting, settings: &Settings, watched_s: f64) -> Result<Self> {
        let (rig, first) = meeting.watched(settings, None, watched_s)?;
        let stopped = rig.stopped.as_deref().map_or("", |why| why.split(':').next().unwrap_or("stopped"));
        let stopped = stopped.to_owned();
        let Some(first) = first else { return Ok(Self { stopped, ..Self::default() }) };
        let rows = &rig.rows;
        let measures = Measures::of(rows, 1e-3);
        let since = |row: &Row| row.t_s - rows[first].t_s;
        let contact = &rows[first..];
        let most = contact.iter().max_by(|a, b| a.largest_force_n.total_cmp(&b.largest_force_n));
        let felt = contact.iter().find(|row| (0..TAXELS).any(|i| row.force_sensed[i] > 0.0));
        let alarm_row = alarm_row(rows, first);
        let cover = CoverMap::<TAXELS, f64>::new(&settings.config.robot.cover.placements())?;
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
            noticed_after_s: alarm_row.map_or(f64::NAN, |row| since(&rows[row])),
            alarm: alarm_row.map(|row| Alarm { row, wrench_base: cover.wrench(&rows[row].force_true) }),
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

/// Row of the first alarm about the touch in row `first`. A false alarm that goes on is none of it: then it is the first force that the
/// cover feels.
fn alarm_row(rows: &[Row], first: usize) -> Option<usize> {
    let touched = |row: &Row| (0..TAXELS).any(|i| row.pressed[i] && row.force_true[i] > 0.0);
    let felt = |row: &Row| row.force_sensed.iter().any(|force_n| *force_n > 0.0);
    let contact = &rows[first..];
    let already =
        first > 0 && (0..TAXELS).any(|i| rows[first - 1].pressed[i] && rows[first].force_true[i] > 0.0);
    let noticed = if already { None } else { contact.iter().position(touched) };
    Some(first + noticed.or_else(|| contact.iter().position(felt))?)
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
