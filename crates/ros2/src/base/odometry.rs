//! Odometry: its validity, its age, and the base's pose until the next message.
//!
//! A message's age is judged by its own stamp, not by when it arrived: a network that comes back delivers what it had
//! kept. The two clocks differ; the least difference seen in the last seconds is taken for their offset, so what is
//! called age is the age beyond the quickest message's.
//!
//! ```
//! use moca_ros2::base::odometry::{OdometryJudge, Refused};
//! use moca_ros2::messages::{Odometry, Quaternion, Time};
//!
//! let mut judge = OdometryJudge::new(100_000_000, [1.5, 1.5, 2.0]);
//! let mut message = Odometry::default();
//! message.pose.pose.orientation = Quaternion::about_z(0.0);
//! assert_eq!(judge.judge(&message, 0), Err(Refused::NoStamp));
//! message.header.stamp = Time::from_unix_ns(7_000_000_000);
//! assert!(judge.judge(&message, 1_000_000_000).is_ok());
//! message.header.stamp = Time::from_unix_ns(7_020_000_000);
//! let late = judge.judge(&message, 1_320_000_000); // 20 ms later by its stamp, 320 ms later by our clock
//! assert!(matches!(late, Err(Refused::Old { age_s }) if (age_s - 0.3).abs() < 1e-9));
//! ```

use crate::messages::Odometry;
use std::f64::consts::{PI, TAU};

/// Shortest time for which a clock offset is remembered, ns; the longest is twice that.
const OFFSET_WINDOW_NS: u64 = 10_000_000_000;
/// Stamps that lie less than this behind the newest are late or repeated, others are of a clock that was set, ns.
const REORDER_NS: u64 = 1_000_000_000;
/// Factor over its speed limit at which a base's pose has jumped.
const SPEED_MARGIN: f64 = 1.5;
/// Allowed displacement on top of that: m, m, rad.
const JUMP_MARGIN: [f64; 3] = [0.05, 0.05, 0.1];
/// Least length of an orientation's quaternion that still says something.
const QUATERNION_MIN: f64 = 0.5;

/// Pose and velocity of a base at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BaseReading {
    /// When it was measured, ns of our clock.
    pub measured_ns: u64,
    /// Pose of B in the odometry's frame: m, m, rad; the angle goes on beyond ±π.
    pub pose_world: [f64; 3],
    /// Velocity in the axes of B: m/s, m/s, rad/s.
    pub velocity_body: [f64; 3],
}

impl BaseReading {
    /// Age at `now_ns`, s.
    pub fn age_s(&self, now_ns: u64) -> f64 {
        seconds(now_ns.saturating_sub(self.measured_ns))
    }

    /// The reading carried on by its own velocity to `now_ns`, but no further than `most_ns`. Pose and its rate, both in
    /// the odometry's frame.
    pub fn predicted(&self, now_ns: u64, most_ns: u64) -> ([f64; 3], [f64; 3]) {
        let ahead_s = seconds(now_ns.saturating_sub(self.measured_ns).min(most_ns));
        let [x, y, yaw] = self.pose_world;
        let [vx, vy, rate] = self.velocity_body;
        // The mean direction of the arc.
        let (sin, cos) = (yaw + 0.5 * ahead_s * rate).sin_cos();
        let pose =
            [x + ahead_s * (cos * vx - sin * vy), y + ahead_s * (sin * vx + cos * vy), yaw + ahead_s * rate];
        let (sin, cos) = pose[2].sin_cos();
        (pose, [cos * vx - sin * vy, sin * vx + cos * vy, rate])
    }
}

/// Why a message of odometry is not used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// NaN or infinity in pose or twist, or no orientation at all.
    #[error("odometry holds a value that is not a number, or no orientation")]
    NotFinite,
    /// Stamp 0: how old it is cannot be told.
    #[error("odometry has no time stamp: set use_sim_time = false on the base, or fix its driver")]
    NoStamp,
    /// Its stamp is not newer than the last.
    #[error("odometry came twice or out of order")]
    Repeated,
    /// Older than the deadline when it came.
    #[error("odometry was {age_s:.3} s old when it came")]
    Old {
        /// s.
        age_s: f64,
    },
    /// The pose moved further than a base can: another frame, or a base that was restarted.
    #[error(
        "odometry jumped by {jump_m:.2} m and {jump_rad:.2} rad: restarted, or localisation in its frame"
    )]
    Jumped {
        /// m.
        jump_m: f64,
        /// rad.
        jump_rad: f64,
    },
    /// Shortly after a jump: the robot has to be stopped before it is believed again.
    #[error("odometry jumped just now")]
    AfterJump,
}

/// Judges one base's odometry. Times are ns of our clock.
#[derive(Clone, Copy, Debug)]
pub struct OdometryJudge {
    deadline_ns: u64,
    velocity_max: [f64; 3],
    offset: Offset,
    last: Option<(u64, BaseReading)>,
    refused_until_ns: u64,
}

impl OdometryJudge {
    /// Refuses what is older than `deadline_ns` or moves faster than a base of these limits: m/s, m/s, rad/s.
    pub const fn new(deadline_ns: u64, velocity_max: [f64; 3]) -> Self {
        Self { deadline_ns, velocity_max, offset: Offset::UNKNOWN, last: None, refused_until_ns: 0 }
    }

    /// The reading in `message`, which arrived at `arrived_ns`.
    ///
    /// # Errors
    /// Why it is not used.
    pub fn judge(&mut self, message: &Odometry, arrived_ns: u64) -> Result<BaseReading, Refused> {
        let (pose, twist) = (&message.pose.pose, &message.twist.twist);
        let length = pose.orientation.array().map(|q| q * q).iter().sum::<f64>().sqrt();
        let mut pose_world = [pose.position.x, pose.position.y, pose.orientation.yaw_rad()];
        let velocity_body = [twist.linear.x, twist.linear.y, twist.angular.z];
        let finite = pose_world.iter().chain(&velocity_body).all(|value| value.is_finite());
        // A NaN length is not long enough either.
        if !(finite && length > QUATERNION_MIN && length < 1.0 / QUATERNION_MIN) {
            return Err(Refused::NotFinite);
        }
        let stamp_ns = message.header.stamp.unix_ns();
        if stamp_ns == 0 {
            return Err(Refused::NoStamp);
        }
        let measured_ns = self.offset.local_ns(stamp_ns, arrived_ns);
        let age_ns = arrived_ns.saturating_sub(measured_ns);
        if age_ns > self.deadline_ns {
            return Err(Refused::Old { age_s: seconds(age_ns) });
        }
        let Some((last_ns, last)) = self.last else {
            return Ok(self.accept(stamp_ns, BaseReading { measured_ns, pose_world, velocity_body }));
        };
        if stamp_ns <= last_ns && last_ns - stamp_ns < REORDER_NS {
            return Err(Refused::Repeated);
        }
        pose_world[2] = last.pose_world[2] + wrapped(pose_world[2] - last.pose_world[2]);
        let reading = self.accept(stamp_ns, BaseReading { measured_ns, pose_world, velocity_body });
        let between_s = seconds(measured_ns.saturating_sub(last.measured_ns));
        let moved: [f64; 3] = std::array::from_fn(|axis| (pose_world[axis] - last.pose_world[axis]).abs());
        let reach = |axis: usize, speed: f64| SPEED_MARGIN * speed * between_s + JUMP_MARGIN[axis];
        let speed = self.velocity_max[0].hypot(self.velocity_max[1]);
        let jump_m = moved[0].hypot(moved[1]);
        if jump_m > reach(0, speed) || moved[2] > reach(2, self.velocity_max[2]) {
            // Longer than the deadline: the loop finds the base stale and stops before it meets the new pose.
            self.refused_until_ns = arrived_ns + 2 * self.deadline_ns;
            return Err(Refused::Jumped { jump_m, jump_rad: moved[2] });
        }
        if arrived_ns < self.refused_until_ns { Err(Refused::AfterJump) } else { Ok(reading) }
    }

    /// Least difference between our clock and the stamps, s: clock offset and the quickest message's way.
    pub fn offset_s(&self) -> Option<f64> {
        #[expect(clippy::cast_precision_loss, reason = "to be shown")]
        self.offset.least().map(|ns| ns as f64 * 1e-9)
    }

    fn accept(&mut self, stamp_ns: u64, reading: BaseReading) -> BaseReading {
        self.last = Some((stamp_ns, reading));
        reading
    }
}

/// The least of arrival − stamp in the present and the last window.
#[derive(Clone, Copy, Debug)]
struct Offset {
    window_ns: u64,
    present: Option<i64>,
    before: Option<i64>,
}

impl Offset {
    const UNKNOWN: Self = Self { window_ns: 0, present: None, before: None };

    fn least(&self) -> Option<i64> {
        self.present.into_iter().chain(self.before).min()
    }

    /// When something with this stamp was measured, by our clock.
    fn local_ns(&mut self, stamp_ns: u64, arrived_ns: u64) -> u64 {
        let age = i128::from(arrived_ns) - i128::from(stamp_ns);
        // Clocks that are three centuries apart are held at that.
        let difference = i64::try_from(age).unwrap_or(if age < 0 { i64::MIN } else { i64::MAX });
        if arrived_ns.saturating_sub(self.window_ns) > OFFSET_WINDOW_NS {
            (self.before, self.present, self.window_ns) = (self.present, None, arrived_ns);
        }
        self.present = Some(self.present.map_or(difference, |least| least.min(difference)));
        let least = self.least().unwrap_or(difference);
        let late_ns = u64::try_from(i128::from(difference) - i128::from(least)).unwrap_or(0);
        arrived_ns.saturating_sub(late_ns)
    }
}

/// Returns the angle within ±π.
fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

fn seconds(ns: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "spans are far below 2^53 ns")]
    let ns = ns as f64;
    ns * 1e-9
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are handed on unchanged, and zero")]
mod tests {
    use super::*;
    use crate::messages::{Quaternion, Time};

    const MS: u64 = 1_000_000;
    const DEADLINE_NS: u64 = 100 * MS;
    /// Our clock began then, by the base's.
    const BOOT_UNIX_NS: u64 = 1_700_000_000_000_000_000;

    fn judge() -> OdometryJudge {
        OdometryJudge::new(DEADLINE_NS, [1.5, 1.5, 2.0])
    }

    fn message(stamp_ns: u64, pose: [f64; 3], velocity: [f64; 3]) -> Odometry {
        let mut odometry = Odometry::default();
        odometry.header.stamp = Time::from_unix_ns(BOOT_UNIX_NS + stamp_ns);
        (odometry.pose.pose.position.x, odometry.pose.pose.position.y) = (pose[0], pose[1]);
        odometry.pose.pose.orientation = Quaternion::about_z(pose[2]);
        (odometry.twist.twist.linear.x, odometry.twist.twist.linear.y) = (velocity[0], velocity[1]);
        odometry.twist.twist.angular.z = velocity[2];
        odometry
    }

    fn at(ms: u64) -> Odometry {
        message(ms * MS, [0.0; 3], [0.0; 3])
    }

    /// 5 s at 50 Hz, each with up to 3 ms on the way.
    fn heard() -> (OdometryJudge, u64) {
        let mut judge = judge();
        let last_ms = 5000;
        for ms in (20..=last_ms).step_by(20) {
            let way = (ms / 20) % 4;
            assert!(judge.judge(&at(ms), (ms + way) * MS).is_ok(), "{ms} ms");
        }
        (judge, last_ms)
    }

    #[test]
    fn what_a_network_kept_is_old_although_it_just_came() {
        let (mut judge, last) = heard();
        // A cable is out for 3 s; all of it comes at once.
        let back = last + 3000;
        let burst: Vec<_> =
            (last + 20..=back).step_by(20).map(|ms| (ms, judge.judge(&at(ms), back * MS))).collect();
        for (ms, verdict) in burst {
            match verdict {
                Ok(reading) => assert!(back - ms <= 100 && reading.age_s(back * MS) <= 0.1, "{ms}"),
                Err(Refused::Old { age_s }) => assert!(age_s > 0.1 && back - ms > 100, "{ms}: {age_s}"),
                Err(other) => panic!("{ms}: {other}"),
            }
        }
    }

    #[test]
    fn age_is_relative_to_quickest_message() {
        let (mut judge, last) = heard();
        let reading = judge.judge(&at(last + 20), (last + 70) * MS).unwrap();
        assert!((reading.age_s((last + 70) * MS) - 0.050).abs() < 1e-9, "{reading:?}");
    }

    #[test]
    fn clock_set_back_makes_base_stale_until_forgotten() {
        let (mut judge, last) = heard();
        let mut ok_again = None;
        for ms in (last + 20..last + 40_000).step_by(20) {
            let verdict = judge.judge(&at(ms - 2000), ms * MS);
            if verdict.is_ok() {
                ok_again.get_or_insert(ms - last);
            } else {
                assert!(matches!(verdict, Err(Refused::Old { .. })), "{verdict:?}");
                assert_eq!(ok_again, None);
            }
        }
        assert!(ok_again.is_some_and(|ms| (5000..=20_040).contains(&ms)), "{ok_again:?}");
    }

    #[test]
    fn twice_and_out_of_order_is_once() {
        let (mut judge, last) = heard();
        let now = (last + 25) * MS;
        assert!(judge.judge(&at(last + 20), now).is_ok());
        assert_eq!(judge.judge(&at(last + 20), now), Err(Refused::Repeated));
        assert_eq!(judge.judge(&at(last + 10), now), Err(Refused::Repeated));
    }

    #[test]
    fn a_jump_leaves_the_base_stale_longer_than_its_deadline() {
        for jump in [[0.5, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.5]] {
            let (mut judge, last) = heard();
            let mut silent = Vec::new();
            for ms in (last + 20..=last + 1000).step_by(20) {
                match judge.judge(&message(ms * MS, jump, [0.0; 3]), ms * MS) {
                    Ok(reading) => {
                        assert_eq!(reading.pose_world.map(|v| (v * 1e6).round()), jump.map(|v| v * 1e6))
                    }
                    Err(refused) => silent.push((ms - last, refused)),
                }
            }
            assert!(matches!(silent[0], (20, Refused::Jumped { .. })), "{jump:?}: {silent:?}");
            let (until, _) = *silent.last().unwrap();
            assert!(until > 20 + DEADLINE_NS / MS && until < 400, "{jump:?}: refused until {until} ms");
        }
    }

    #[test]
    fn a_base_at_its_limits_does_not_jump() {
        let (mut judge, last) = heard();
        for i in 1..=100_u32 {
            let s = f64::from(i) * 0.02;
            let moved = message((last + 20 * u64::from(i)) * MS, [1.5 * s, 1.5 * s, 2.0 * s], [0.0; 3]);
            assert!(judge.judge(&moved, (last + 20 * u64::from(i)) * MS).is_ok(), "{i}");
        }
    }

    #[test]
    fn yaw_goes_on_beyond_half_a_turn() {
        let mut judge = judge();
        let mut yaw = 0.0;
        for i in 1..=1000_u32 {
            let wanted = f64::from(i) * 0.03;
            let ms = u64::from(i) * 20;
            yaw =
                judge.judge(&message(ms * MS, [0.0, 0.0, wanted], [0.0; 3]), ms * MS).unwrap().pose_world[2];
            assert!((yaw - wanted).abs() < 1e-9, "{yaw} {wanted}");
        }
        assert!(yaw > 4.0 * TAU);
    }

    #[test]
    fn nothing_that_is_not_a_number_gets_in() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for field in 0..6 {
                let mut values = [0.0; 6];
                values[field] = bad;
                let [a, b, c, d, e, f] = values;
                assert_eq!(judge().judge(&message(MS, [a, b, c], [d, e, f]), MS), Err(Refused::NotFinite));
            }
        }
        let mut no_orientation = at(1);
        no_orientation.pose.pose.orientation = Quaternion::default();
        assert_eq!(judge().judge(&no_orientation, MS), Err(Refused::NotFinite));
    }

    #[test]
    fn prediction_follows_the_arc_and_ends_at_the_deadline() {
        let reading =
            BaseReading { measured_ns: 0, pose_world: [1.0, 2.0, 0.5], velocity_body: [0.4, -0.2, 0.8] };
        let (at_once, _) = reading.predicted(0, DEADLINE_NS);
        assert_eq!(at_once, reading.pose_world);
        // The exact arc at 50 ms: the integral of R(yaw + w·t)·v.
        let (t, w, yaw) = (0.05_f64, 0.8_f64, 0.5_f64);
        let (s, c) = (((yaw + w * t).sin() - yaw.sin()) / w, (yaw.cos() - (yaw + w * t).cos()) / w);
        let exact = [1.0 + s * 0.4 + c * 0.2, 2.0 + c * 0.4 - s * 0.2, yaw + w * t];
        let (pose, velocity) = reading.predicted(50 * MS, DEADLINE_NS);
        for (got, wanted) in pose.iter().zip(exact) {
            assert!((got - wanted).abs() < 2e-6, "{pose:?} {exact:?}");
        }
        assert!((velocity[0].hypot(velocity[1]) - 0.4_f64.hypot(0.2)).abs() < 1e-12);
        assert_eq!(reading.predicted(100 * MS, DEADLINE_NS), reading.predicted(900 * MS, DEADLINE_NS));
    }
}
