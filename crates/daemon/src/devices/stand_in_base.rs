//! A base that is not there yet, under an arm that is: its velocity servo without a wire, so that a whole robot can be tried
//! before its base drives.

use moca_msgs::robot::BaseTable;

/// Pose and velocity of a base that follows its commands as the table of the base says.
#[derive(Clone, Copy, Debug)]
pub struct StandInBase {
    pose_world: [f64; 3],
    velocity_body: [f64; 3],
    period_s: f64,
    time_constant_s: f64,
    acceleration_max: [f64; 3],
}

impl StandInBase {
    /// At the origin of W, at rest.
    pub fn new(base: &BaseTable, period_s: f64) -> Self {
        let (linear, yaw) = (base.acceleration_max_m_s2, base.yaw_acceleration_max_rad_s2);
        Self {
            pose_world: [0.0; 3],
            velocity_body: [0.0; 3],
            period_s,
            time_constant_s: base.servo_time_constant_s,
            acceleration_max: [linear, linear, yaw],
        }
    }

    /// Pose in W, and its rate.
    pub fn state_world(&self) -> ([f64; 3], [f64; 3]) {
        let [vx, vy, yaw_rate] = self.velocity_body;
        let (sin, cos) = self.pose_world[2].sin_cos();
        (self.pose_world, [cos * vx - sin * vy, sin * vx + cos * vy, yaw_rate])
    }

    /// Follows `wanted` (axes of B) for `ticks` control periods.
    pub fn follow(&mut self, wanted: [f64; 3], ticks: u64) {
        /// Longest time for which a base without orders drives on; then it has stopped.
        const MOST: u64 = 250;
        let share = 1.0 - (-self.period_s / self.time_constant_s).exp();
        for _ in 0..ticks.min(MOST) {
            for (i, velocity) in self.velocity_body.iter_mut().enumerate() {
                let most = self.acceleration_max[i] * self.period_s;
                *velocity += (share * (wanted[i] - *velocity)).clamp(-most, most);
            }
            let (_, rate) = self.state_world();
            self.pose_world.iter_mut().zip(rate).for_each(|(at, rate)| *at += rate * self.period_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::robot::SUMMIT_XL;

    #[test]
    fn it_reaches_what_it_is_told_and_drives_where_it_looks() {
        let mut base = StandInBase::new(&SUMMIT_XL, 1e-3);
        base.follow([0.0, 0.0, 0.5], 1);
        for _ in 0..3000 {
            base.follow([0.2, 0.0, 0.5], 1);
        }
        let ([.., yaw], [vx, vy, yaw_rate]) = base.state_world();
        assert!((vx.hypot(vy) - 0.2).abs() < 1e-3 && (yaw_rate - 0.5).abs() < 1e-3);
        assert!((vy.atan2(vx) - yaw).abs() < 1e-3, "along its own x axis");
        for _ in 0..3000 {
            base.follow([0.0; 3], 1);
        }
        let (still, rate) = base.state_world();
        assert!(rate.iter().all(|rate| rate.abs() < 1e-3));
        base.follow([0.0; 3], u64::MAX);
        assert!(base.state_world().0.iter().zip(still).all(|(now, then)| (now - then).abs() < 1e-3));
    }
}
