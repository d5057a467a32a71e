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
}
