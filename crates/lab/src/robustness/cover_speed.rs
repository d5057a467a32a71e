//! Speed that the cover may have in a tick, by the definition of the speed limit.
//!
//! The limit bounds what the robot drives: the commanded velocity is within it in every tick, or on its way there as fast as the
//! base brakes. The measured speed may be above it for two reasons, and by no more than they explain:
//! - A limit that falls is followed with the base's deceleration and its servo's lag.
//! - What pushes the base moves it against its servo, by the force over the servo's damping: hands, and the robot's own inertia.

use anyhow::Result;
use moca_control::config::Config;
use moca_experiments::TAXELS;
use moca_sim::{SERVO_DAMPING, SimPlant};
use moca_wbc::guard::CoverOutline;

/// Time constant with which the base comes back from a push against its servo, s: its mass over the servo's damping, rounded up.
const GIVE_S: f64 = 2e-3;

/// Everything that pushed the base in a control period.
#[derive(Clone, Debug)]
pub(super) struct Pushes<'a> {
    /// Mean force of the hands on each taxel, N, T1 first.
    pub(super) taxel_force_n: &'a [f64],
    /// Mean wrench of the robot's own inertia, of an arm that swings and a base that brakes, axes of W: N, N, N·m.
    pub(super) inertia_world: [f64; 3],
}

/// Wrench of the robot's own inertia on its wheels, from the change of its momentum.
#[derive(Debug, Default)]
pub(super) struct Inertia {
    momentum_world: Option<[f64; 3]>,
}

impl Inertia {
    /// Returns the mean over the control period of `period_s` that has just ended, axes of W: N, N, N·m.
    pub(super) fn after(&mut self, plant: &mut SimPlant, period_s: f64) -> [f64; 3] {
        let now = plant.momentum_world();
        let before = self.momentum_world.replace(now).unwrap_or(now);
        std::array::from_fn(|i| (before[i] - now[i]) / period_s)
    }
}

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

    /// Largest speed of the cover in a tick with this limit, m/s. `pushes` are those of the period that begins with it.
    pub(super) fn allowed_m_s(&mut self, limit_m_s: f64, pushes: &Pushes<'_>) -> f64 {
        // The state is measured before the tick's command, and before its forces.
        let lag = (-self.period_s / self.servo_s).exp();
        let followed = self.commanded_m_s + (self.driven_m_s - self.commanded_m_s) * lag;
        self.driven_m_s = self.commanded_m_s.max(followed);
        self.commanded_m_s = limit_m_s.max(self.commanded_m_s - self.braking_m_s2 * self.period_s);
        self.pushed_m_s = self.given_m_s.max(self.pushed_m_s * (-self.period_s / GIVE_S).exp());
        self.given_m_s = self.given_m_s(pushes);
        self.driven_m_s.max(limit_m_s) + self.pushed_m_s
    }

    /// Largest speed that hands and inertia give the cover against the base's servo in the end, m/s.
    fn given_m_s(&self, pushes: &Pushes<'_>) -> f64 {
        let force_n = std::array::from_fn(|i| pushes.taxel_force_n.get(i).copied().unwrap_or(0.0));
        let [x, y, yaw] = self.outline.map().wrench(&force_n);
        let [own_x, own_y, own_yaw] = pushes.inertia_world;
        // The servo yields alike in every direction of the floor.
        let (hands_n, own_n) = (x.hypot(y), own_x.hypot(own_y));
        let [along_x, _, about] = SERVO_DAMPING;
        self.outline.fastest(&[0.0, 0.0, (yaw.abs() + own_yaw.abs()) / about]) + (hands_n + own_n) / along_x
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
            let pushes = Pushes { taxel_force_n: &forces, inertia_world: [0.0; 3] };
            (0..ticks).fold(0.0, |_, _| speed.allowed_m_s(limit_m_s, &pushes))
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
