//! How fast physics lets a base meet a body, whatever its law.

use anyhow::Result;
use moca_sim::foam::Foam;
use moca_tactile::Firmware;
use moca_wbc::contact_stability::{Contact, speed_for_stopping};

/// What four counts hide, read as PU LD30, N.
const THRESHOLD_N: f64 = 5.2;

/// A meeting of cover and body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Meeting {
    pub foam: Foam,
    /// Stiffness of the body, N/m.
    pub tissue_n_m: f64,
    /// Force that must not be exceeded, N.
    pub limit_n: f64,
    /// Of the base, m/s².
    pub deceleration_m_s2: f64,
    /// Time constant of the base's servo, s.
    pub servo_s: f64,
    pub board: Firmware,
}

impl Meeting {
    /// Largest speed at which the force stays under the limit, m/s: what the threshold hides, then the board's worst delay
    /// and the servo's lag at full speed, then braking, within what foam and body yield.
    pub(crate) fn bound_m_s(&self) -> Result<f64> {
        let hidden_m = Foam::PU_LD30.ramp_deformation_m(THRESHOLD_N);
        let hidden_n = self.foam.elastic_force_n(hidden_m);
        let travel_m =
            self.foam.deformation_m(self.limit_n) - hidden_m + (self.limit_n - hidden_n) / self.tissue_n_m;
        let contact = Contact {
            stiffness_n_m: 1.0, // not asked for
            damping_n_s_m: 0.0,
            delay_s: moca_msgs::seconds(self.board.worst_hold_ns()),
            servo_s: self.servo_s,
        };
        Ok(speed_for_stopping(travel_m.max(0.0), self.deceleration_m_s2, &contact)?)
    }

    /// Force on a body that is met at `speed_m_s` and felt `felt_after_s` later by a base that then does all it can, N.
    pub(crate) fn least_n(&self, speed_m_s: f64, felt_after_s: f64) -> f64 {
        let way_m = speed_m_s * (felt_after_s + self.servo_s)
            + speed_m_s * speed_m_s / (2.0 * self.deceleration_m_s2);
        let together_m = |force_n: f64| self.foam.deformation_m(force_n) + force_n / self.tissue_n_m;
        let (mut low, mut high) = (0.0, 1e4);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if together_m(middle) <= way_m { low = middle } else { high = middle }
        }
        low
    }
}

#[cfg(test)]
#[test]
fn at_the_bound_the_least_force_is_the_limit() {
    let meeting = Meeting {
        foam: Foam::COLLISION_ASSUMED,
        tissue_n_m: 50e3,
        limit_n: 25.0,
        deceleration_m_s2: 3.0,
        servo_s: 0.015,
        board: Firmware::Moca,
    };
    let bound_m_s = meeting.bound_m_s().unwrap();
    let hidden_m = Foam::PU_LD30.ramp_deformation_m(THRESHOLD_N);
    // felt when the threshold is crossed, and a worst delay later
    let hidden_m = hidden_m + meeting.foam.elastic_force_n(hidden_m) / meeting.tissue_n_m;
    let felt_after_s = hidden_m / bound_m_s + moca_msgs::seconds(meeting.board.worst_hold_ns());
    let least_n = meeting.least_n(bound_m_s, felt_after_s);
    assert!((least_n - meeting.limit_n).abs() < 1e-6, "{least_n} N");
    assert!(meeting.least_n(0.9 * bound_m_s, felt_after_s) < 23.0);
}
