//! Fastest speed at which physics lets a base meet a body, whatever its law.

use anyhow::Result;
use moca_sim::foam::Foam;
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
