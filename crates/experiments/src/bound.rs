//! Fastest speed at which physics lets a base meet a body, whatever its law.

use anyhow::Result;
use moca_sim::contact::{ContactState, Pressing};
use moca_sim::foam::Foam;
use moca_sim::{Mobility, Tissue};
use moca_tactile::Firmware;
use moca_wbc::contact_stability::{Contact, speed_for_stopping};

/// Force that four counts hide, read as PU LD30, N.
const THRESHOLD_N: f64 = 5.2;

/// From the middle of T6 to its seam with T5, m: half the distance of two taxels in front.
pub const TO_THE_SEAM_M: f64 = 0.776 / 6.0;

/// A meeting of cover and body.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    /// Foam of the cover.
    pub foam: Foam,
    /// Stiffness of the body, N/m.
    pub tissue_n_m: f64,
    /// Force that must not be exceeded, N.
    pub limit_n: f64,
    /// Deceleration of the base, m/s².
    pub deceleration_m_s2: f64,
    /// Time constant of the base's servo, s.
    pub servo_s: f64,
    /// Delay of an order on its way to that servo, s.
    pub order_delay_s: f64,
    /// Firmware of the board, which says how old a reading may be.
    pub board: Firmware,
    /// Number of taxels that read equal parts of the force: two on a seam.
    pub sharing: f64,
}

impl Meeting {
    /// Largest speed at which the force stays under the limit, m/s: what the threshold hides, then the board's worst delay
    /// and the servo's lag at full speed, then braking, within what foam and body yield.
    pub fn bound_m_s(&self) -> Result<f64> {
        let hidden_n = self.hidden_n();
        let travel_m = self.together_m(self.limit_n) - self.together_m(hidden_n);
        let contact = Contact {
            stiffness_n_m: 1.0, // not asked for
            damping_n_s_m: 0.0,
            delay_s: moca_msgs::seconds(self.board.worst_hold_ns()),
            servo_s: self.order_delay_s + self.servo_s,
        };
        Ok(speed_for_stopping(travel_m.max(0.0), self.deceleration_m_s2, &contact)?)
    }

    /// Largest force that no taxel feels yet, N.
    fn hidden_n(&self) -> f64 {
        self.sharing * self.foam.elastic_force_n(Foam::PU_LD30.ramp_deformation_m(THRESHOLD_N))
    }

    /// Returns the compression of foam and body under a force, m.
    fn together_m(&self, force_n: f64) -> f64 {
        self.foam.deformation_m(force_n) + force_n / self.tissue_n_m
    }

    /// Force on a body that is met at `speed_m_s` and felt `felt_after_s` later by a base that then does all it can, N.
    pub fn least_n(&self, speed_m_s: f64, felt_after_s: f64) -> f64 {
        let way_m = speed_m_s * (felt_after_s + self.order_delay_s + self.servo_s)
            + speed_m_s * speed_m_s / (2.0 * self.deceleration_m_s2);
        let (mut low, mut high) = (0.0, 1e4);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.together_m(middle) <= way_m { low = middle } else { high = middle }
        }
        low
    }
}

/// Way in which a body and the base come together.
#[derive(Clone, Copy, Debug)]
pub struct Closing {
    /// Speed of the base towards the body, m/s.
    pub base_m_s: f64,
    /// Speed of the body towards the base, m/s.
    pub walk_m_s: f64,
    /// Motion of the body when it is pushed.
    pub mobility: Mobility,
    /// Time from the first touch to the first alarm, s.
    pub felt_after_s: f64,
    /// Fastest order that the base may be given, m/s.
    pub flees_m_s: f64,
    /// Largest change of an order, m/s².
    pub order_m_s2: f64,
    /// Time between two orders that the base takes, s; 0: it takes each.
    pub order_period_s: f64,
}

/// Step of the integration, s, and its length.
const STEP_S: f64 = 1e-4;
const STEPS: u32 = 30_000;
/// Phases of the orders against the alarm, of which the best counts.
const PHASES: u32 = 8;

impl Meeting {
    /// Largest force on the body when the base does its utmost from the first alarm on, N: no law does better along that line. Cover,
    /// body and base are integrated, the base within the limits of its servo and of its orders. When it takes an order after the alarm
    /// is as it suits the law best.
    pub fn least_of_any_law_n(&self, closing: &Closing) -> f64 {
        self.least_at_phases_n(closing).fold(f64::INFINITY, f64::min)
    }

    /// Force below which no law can promise to stay, N: as [`Self::least_of_any_law_n`], but the base takes an order after the alarm
    /// when it suits the law worst. A law does not know the phase beforehand.
    pub fn least_to_promise_n(&self, closing: &Closing) -> f64 {
        self.least_at_phases_n(closing).fold(0.0, f64::max)
    }

    /// That force for each phase of the orders against the alarm.
    fn least_at_phases_n(&self, closing: &Closing) -> impl Iterator<Item = f64> {
        let shares = if closing.order_period_s > 0.0 { PHASES } else { 1 };
        let phase_s = move |phase| closing.order_period_s * f64::from(phase) / f64::from(shares);
        (0..shares).map(move |phase| self.least_at_phase_n(closing, phase_s(phase)))
    }

    /// That force where the base takes its first order `phase_s` after the alarm.
    fn least_at_phase_n(&self, closing: &Closing, phase_s: f64) -> f64 {
        let Closing { base_m_s, walk_m_s, mobility, felt_after_s, flees_m_s, order_m_s2, order_period_s } =
            *closing;
        let tissue = Tissue { stiffness_n_per_m: self.tissue_n_m, damping_n_s_per_m: 0.0 };
        let (mut contact, mut most_n) = (ContactState::default(), 0.0_f64);
        let (mut base, mut body) = ([0.0, base_m_s], [0.0, walk_m_s]);
        let obeys_s = felt_after_s + self.order_delay_s;
        let gain = -(-STEP_S / self.servo_s).exp_m1();
        let most_m_s = self.deceleration_m_s2 * STEP_S;
        for step in 0..STEPS {
            let t_s = f64::from(step) * STEP_S;
            let mut ordered_s = (t_s - obeys_s).max(0.0);
            if order_period_s > 0.0 {
                let taken = ((ordered_s - phase_s) / order_period_s).floor();
                ordered_s = (phase_s + taken * order_period_s).max(0.0);
            }
            let order_m_s = (base_m_s - order_m_s2 * ordered_s).max(-flees_m_s);
            base[1] += (gain * (order_m_s - base[1])).clamp(-most_m_s, most_m_s);
            let normal_n = contact
                .step(&Pressing {
                    foam: &self.foam,
                    tissue,
                    friction: 0.0,
                    overlap_m: base[0] + body[0],
                    sliding_m_s: 0.0,
                    dt_s: STEP_S,
                    yield_m_per_n: mobility.yield_m_per_n(STEP_S),
                })
                .normal_n;
            most_n = most_n.max(normal_n);
            if let Mobility::Standing { mass_kg, stiffness_n_per_m, damping_n_s_per_m } = mobility {
                let held_n = stiffness_n_per_m * (walk_m_s * t_s - body[0]);
                let damped_n = damping_n_s_per_m * (walk_m_s - body[1]);
                body[1] += STEP_S / mass_kg * (held_n + damped_n - normal_n);
            }
            (base[0], body[0]) = (base[0] + STEP_S * base[1], body[0] + STEP_S * body[1]);
        }
        most_n
    }
}

#[cfg(test)]
#[test]
fn no_law_beats_bound_of_any_law() {
    let meeting = Meeting {
        foam: Foam::COLLISION_ASSUMED,
        tissue_n_m: 50e3,
        limit_n: 25.0,
        deceleration_m_s2: 3.0,
        servo_s: 0.015,
        order_delay_s: 0.02,
        board: Firmware::Moca,
        sharing: 1.0,
    };
    let closing = |walk_m_s, base_m_s, felt_after_s| Closing {
        base_m_s,
        walk_m_s,
        mobility: Mobility::Fixed,
        felt_after_s,
        flees_m_s: 1.0,
        order_m_s2: 3.0,
        order_period_s: 0.0,
    };
    let held = |walk_m_s, base_m_s, felt_after_s| {
        meeting.least_of_any_law_n(&closing(walk_m_s, base_m_s, felt_after_s))
    };
    // before the base obeys, the depth is that of a straight approach, and braking adds the way of its servo
    let (speed_m_s, felt_s) = (0.1, 0.03);
    let by_hand_n = meeting.least_n(speed_m_s, felt_s);
    let least_n = held(0.0, speed_m_s, felt_s);
    assert!(least_n < by_hand_n && least_n > 0.8 * by_hand_n, "{least_n} N of {by_hand_n} N");
    // whoever comes is met as hard as whoever is driven into, but for where the servo starts
    assert!((held(speed_m_s, 0.0, felt_s) / least_n - 1.0).abs() < 0.05);
    assert!(held(0.05, 0.0, felt_s) < held(0.05, 0.0, felt_s + 0.02));
    // a base that takes orders now and then does worse than one that takes each, and no worse than one that takes each so much later
    let seldom = |order_period_s| {
        meeting.least_of_any_law_n(&Closing { order_period_s, ..closing(0.05, 0.0, felt_s) })
    };
    let [each_n, seldom_n, late_n] = [seldom(0.0), seldom(0.02), held(0.05, 0.0, felt_s + 0.02)];
    assert!(each_n < seldom_n && seldom_n < late_n, "{each_n} {seldom_n} {late_n} N");
    // and can promise no more than of its worst phase
    let promised_n = |order_period_s| {
        meeting.least_to_promise_n(&Closing { order_period_s, ..closing(0.05, 0.0, felt_s) })
    };
    assert!((promised_n(0.0) - each_n).abs() < 1e-12, "{each_n} N");
    assert!(promised_n(0.02) > seldom_n && promised_n(0.02) < late_n, "{seldom_n} {late_n} N");
    let loose = Mobility::Standing { mass_kg: 3.0, stiffness_n_per_m: 800.0, damping_n_s_per_m: 300.0 };
    let free_n = meeting.least_of_any_law_n(&Closing { mobility: loose, ..closing(0.2, 0.0, felt_s) });
    assert!(free_n < held(0.2, 0.0, felt_s), "a light body yields");
}

#[cfg(test)]
#[test]
fn at_the_bound_the_least_force_is_the_limit() {
    let middle = Meeting {
        foam: Foam::COLLISION_ASSUMED,
        tissue_n_m: 50e3,
        limit_n: 25.0,
        deceleration_m_s2: 3.0,
        servo_s: 0.015,
        order_delay_s: 0.0,
        board: Firmware::Moca,
        sharing: 1.0,
    };
    let seam = Meeting { sharing: 2.0, ..middle };
    for meeting in [middle, seam] {
        let bound_m_s = meeting.bound_m_s().unwrap();
        // felt when the threshold is crossed, and a worst delay later
        let hidden_m = meeting.together_m(meeting.hidden_n());
        let felt_after_s = hidden_m / bound_m_s + moca_msgs::seconds(meeting.board.worst_hold_ns());
        let least_n = meeting.least_n(bound_m_s, felt_after_s);
        assert!((least_n - meeting.limit_n).abs() < 1e-6, "{least_n} N");
        assert!(meeting.least_n(0.9 * bound_m_s, felt_after_s) < 23.0);
    }
    assert!(seam.bound_m_s().unwrap() < middle.bound_m_s().unwrap());
}
