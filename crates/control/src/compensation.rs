//! Compensation of loads that the arm's model does not know: heavier links, a tool, friction of the joints. Pure.
//!
//! The momentum observer ([`moca_wbc::momentum_observer`]) estimates the joint torque beside the model's, r. Its slow part is taken
//! for a load b and commanded against. While the arm is held, and in the first second, b follows r: that is its zero, and nobody may
//! push the flange then.
//! While a law moves the arm, b follows with `time_s` and stays within `bound_nm` of that zero. Where r is off b by more than
//! `push_nm` in any joint, less its known friction, somebody pushes: b then follows `PUSHED_SHARE` as fast. So a quick push meets the
//! spring of the impedance law, and a steady one takes at most `bound_nm` from each joint, whatever its force and length.
//! docs/math.md has the proof.
//!
//! Friction turns round with the speed of a joint, faster than b follows. What is known of it is commanded against at once, and taken
//! out of the measured torque: law and observer then see an arm with the rest of its friction.
//!
//! Without it nothing is computed, and no bit of a command changes.

use crate::config::Config;
use crate::robot::JOINTS;
use moca_msgs::{Parameters, RobotState};
use moca_wbc::ControlLaw;
use serde::{Deserialize, Serialize};

/// Shortest time constant: five times the lag of the observer, s.
pub const SHORTEST_S: f64 = 0.1;
/// Time constant with which a load is taken in while the arm is held, and in the first [`FIRST_S`], s.
const HELD_S: f64 = 0.2;
/// Time for which the first load is taken in, even if a law moves the arm already, s.
const FIRST_S: f64 = 1.0;
/// Largest load of a joint that is believed while it is so taken in, N·m.
const LARGEST_NM: f64 = 20.0;
/// Share of its speed with which a load is followed while somebody pushes.
const PUSHED_SHARE: f64 = 0.01;

/// Smallest deviation that counts as a push, N·m, where the known friction leaves less of `push_nm`: noise of the torques is below it.
const LEAST_PUSH_NM: f64 = 0.5;

/// Speed of a joint at which 0.7 of its friction is compensated, rad/s. A larger one leaves more of the friction; a smaller one
/// turns noise of the speed into torque.
const SMOOTHING_RAD_S: f64 = 0.01;

/// Loads of one arm.
#[derive(Clone, Copy, Debug)]
pub struct Compensation {
    joints: usize,
    /// Time constant of the loads, s; 0: none is learnt.
    time_s: f64,
    /// Known friction of each joint, N·m.
    friction_nm: [f64; JOINTS],
    /// Deviation of each joint that counts as a push, N·m.
    push_nm: [f64; JOINTS],
    bound_nm: f64,
    torque_max_nm: [f64; JOINTS],
    torque_rate_nm_s: f64,
    period_s: f64,
    state: CompensationState,
}

/// Memory of a [`Compensation`] between ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CompensationState {
    /// Torque that the load puts on each joint, N·m.
    load_nm: [f64; JOINTS],
    /// Torque of the load when a law began to move the arm, N·m.
    zero_nm: [f64; JOINTS],
    /// Torque that was commanded last, N·m; `None` before the first.
    sent_nm: Option<[f64; JOINTS]>,
    /// Time for which a load has been taken in, up to [`FIRST_S`], s.
    taken_in_s: f64,
}

impl Compensation {
    /// Compensation as configured; `None` where it is off or there is no arm.
    pub fn new(config: &Config, parameters: &Parameters<JOINTS>) -> Option<Self> {
        let of = &config.control.compensation;
        let is_on = of.time_s > 0.0 || of.friction_nm.iter().any(|friction_nm| *friction_nm > 0.0);
        let friction_nm: [f64; JOINTS] =
            std::array::from_fn(|i| of.friction_nm.get(i).copied().unwrap_or(0.0));
        (is_on && config.plant.parts.has_arm()).then(|| Self {
            joints: config.arm().joints,
            time_s: of.time_s,
            friction_nm,
            // Friction that turns round changes r by twice itself, and by what is known of it less.
            push_nm: friction_nm.map(|friction_nm| (of.push_nm - friction_nm).max(LEAST_PUSH_NM)),
            bound_nm: of.bound_nm,
            torque_max_nm: parameters.limits.torque_nm,
            torque_rate_nm_s: parameters.limits.torque_rate_nm_s,
            period_s: parameters.limits.period_s,
            state: CompensationState::default(),
        })
    }

    /// Returns its memory.
    pub const fn state(&self) -> CompensationState {
        self.state
    }

    /// Goes on from where `state` was taken.
    pub const fn restore(&mut self, state: &CompensationState) {
        self.state = *state;
    }

    /// The arm is no longer commanded: the next torque follows from none before it. The loads stay.
    pub const fn leave(&mut self) {
        self.state.sent_nm = None;
    }

    /// Torque that the load puts on each joint, N·m.
    pub const fn load_nm(&self) -> &[f64; JOINTS] {
        &self.state.load_nm
    }

    /// Torque against the known friction at the speeds of the joints, N·m: f q̇/√(q̇² + v²).
    fn against_friction_nm(&self, dq_rad_s: &[f64; JOINTS]) -> [f64; JOINTS] {
        std::array::from_fn(|i| self.friction_nm[i] * dq_rad_s[i] / dq_rad_s[i].hypot(SMOOTHING_RAD_S))
    }

    /// Returns the state of an arm without the known friction: what is commanded against it is taken out of the measured torque.
    /// `None` where none is known.
    pub fn without_friction(&self, robot: &RobotState<JOINTS>) -> Option<RobotState<JOINTS>> {
        if self.friction_nm.iter().all(|friction_nm| *friction_nm <= 0.0) {
            return None;
        }
        let mut robot = *robot;
        let against_nm = self.against_friction_nm(&robot.dq_rad_s);
        robot.torque_measured_nm.iter_mut().zip(against_nm).for_each(|(torque, against)| *torque -= against);
        Some(robot)
    }

    /// Takes in the observer's estimate `external_nm` of the last tick, `None` where it does not run, and puts the torque against
    /// the load, and against the known friction at the speeds `dq_rad_s`, into a command.
    pub fn apply(
        &mut self,
        law: ControlLaw,
        external_nm: Option<&[f64; JOINTS]>,
        dq_rad_s: &[f64; JOINTS],
        dt_s: f64,
        torque_nm: &mut [f64; JOINTS],
    ) {
        if let Some(external_nm) = external_nm.filter(|_| self.time_s > 0.0) {
            self.follow(law, external_nm, dt_s);
        }
        let against_nm = self.against_friction_nm(dq_rad_s);
        let step_nm = self.torque_rate_nm_s * dt_s.min(self.period_s);
        let last_nm = self.state.sent_nm;
        for (i, torque) in torque_nm[..self.joints].iter_mut().enumerate() {
            let most = self.torque_max_nm[i];
            *torque = (*torque - self.state.load_nm[i] + against_nm[i]).clamp(-most, most);
            if let Some(last) = last_nm {
                *torque = torque.clamp(last[i] - step_nm, last[i] + step_nm);
            }
        }
        self.state.sent_nm = Some(*torque_nm);
    }

    /// One step of the loads towards `external_nm`.
    fn follow(&mut self, law: ControlLaw, external_nm: &[f64; JOINTS], dt_s: f64) {
        let state = &mut self.state;
        let is_held = law == ControlLaw::Hold || state.taken_in_s < FIRST_S;
        state.taken_in_s = (state.taken_in_s + dt_s).min(FIRST_S);
        let is_pushed = (0..self.joints).any(|i| (external_nm[i] - state.load_nm[i]).abs() > self.push_nm[i]);
        let per_s = match (is_held, is_pushed) {
            (true, _) => 1.0 / HELD_S,
            (false, true) => PUSHED_SHARE / self.time_s,
            (false, false) => 1.0 / self.time_s,
        };
        let share = -(-dt_s * per_s).exp_m1();
        for (i, external_nm) in external_nm[..self.joints].iter().enumerate() {
            let (middle, most) = if is_held { (0.0, LARGEST_NM) } else { (state.zero_nm[i], self.bound_nm) };
            let next = state.load_nm[i] + share * (external_nm - state.load_nm[i]);
            state.load_nm[i] = next.clamp(middle - most, middle + most);
        }
        if is_held {
            state.zero_nm = state.load_nm;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_S: f64 = 1e-3;

    fn compensation() -> Compensation {
        let mut config = Config::default();
        config.control.compensation.time_s = 0.5;
        Compensation::new(&config, &config.parameters()).unwrap()
    }

    fn run(
        compensation: &mut Compensation,
        law: ControlLaw,
        external_nm: f64,
        seconds: f64,
    ) -> [f64; JOINTS] {
        let mut torque_nm = [0.0; JOINTS];
        let mut t_s = 0.0;
        while t_s < seconds {
            torque_nm = [0.0; JOINTS];
            compensation.apply(law, Some(&[external_nm; JOINTS]), &[0.0; JOINTS], TICK_S, &mut torque_nm);
            t_s += TICK_S;
        }
        torque_nm
    }

    #[test]
    fn nothing_is_compensated_by_default_or_without_an_arm() {
        let mut config = Config::default();
        assert!(Compensation::new(&config, &config.parameters()).is_none());
        config.control.compensation.time_s = 0.5;
        assert!(Compensation::new(&config, &config.parameters()).is_some());
        config.plant.parts = crate::robot::Parts::Base;
        assert!(Compensation::new(&config, &config.parameters()).is_none());
    }

    #[test]
    fn held_arm_takes_any_load_in_up_to_20_nm() {
        let mut load = compensation();
        let torque_nm = run(&mut load, ControlLaw::Hold, 8.0, 3.0);
        assert!((torque_nm[0] + 8.0).abs() < 0.01 && torque_nm[7].abs() < 1e-12, "{torque_nm:?}");
        run(&mut load, ControlLaw::Hold, 100.0, 10.0);
        assert!((load.load_nm()[0] - 20.0).abs() < 1e-9);
    }

    #[test]
    fn first_load_is_taken_in_by_an_arm_that_moves_at_once() {
        let mut load = compensation();
        run(&mut load, ControlLaw::Impedance, 12.0, 1.1);
        assert!((load.load_nm()[0] - 12.0).abs() < 0.1, "{:?}", load.load_nm());
    }

    #[test]
    fn steady_push_winds_up_to_its_bound_and_unwinds() {
        let mut load = compensation();
        run(&mut load, ControlLaw::Hold, 5.0, 3.0);
        let zero = load.load_nm()[0];
        run(&mut load, ControlLaw::Impedance, zero + 7.5, 1.0);
        let one_second = load.load_nm()[0] - zero;
        assert!((0.1..0.2).contains(&one_second), "{one_second} N·m after a second of pushing");
        for push_nm in [7.5, 40.0, 1000.0] {
            run(&mut load, ControlLaw::Impedance, zero + push_nm, 120.0);
            let wound = load.load_nm()[0] - zero;
            assert!((wound - 4.0).abs() < 1e-9, "{wound} N·m of {push_nm} N·m");
        }
        run(&mut load, ControlLaw::Impedance, zero, 60.0);
        assert!((load.load_nm()[0] - zero).abs() < 1e-3, "nothing is left of it");
    }

    #[test]
    fn load_below_a_push_is_followed_with_its_time_constant() {
        let mut load = compensation();
        run(&mut load, ControlLaw::Hold, 0.0, 1.1);
        run(&mut load, ControlLaw::Impedance, 2.0, 0.5);
        let share = load.load_nm()[0] / 2.0;
        assert!((share - (1.0 - (-1.0_f64).exp())).abs() < 0.01, "{share}");
    }

    #[test]
    fn push_begins_where_known_friction_ends() {
        // 2.2 N·m of a joint whose friction is not known, 1.4 where 0.8 are; 0.5 where nothing would be left
        for (known_nm, least_nm) in [(0.0, 2.2), (0.8, 1.4), (9.0, 0.5)] {
            for (push_nm, follows) in [(least_nm - 0.01, true), (least_nm + 0.01, false)] {
                let mut config = Config::default();
                config.control.compensation.time_s = 0.5;
                config.control.compensation.friction_nm = vec![known_nm; 7];
                let mut load = Compensation::new(&config, &config.parameters()).unwrap();
                run(&mut load, ControlLaw::Hold, 0.0, 1.1);
                run(&mut load, ControlLaw::Impedance, push_nm, 0.01);
                let share = load.load_nm()[0] / push_nm;
                assert_eq!(share > 0.01, follows, "{push_nm} N·m where {known_nm} are known: {share}");
            }
        }
    }

    #[test]
    fn command_stays_within_torque_limits_and_their_rate() {
        let mut load = compensation();
        run(&mut load, ControlLaw::Hold, 15.0, 3.0);
        let mut torque_nm = [-86.0; JOINTS];
        load.apply(ControlLaw::Impedance, None, &[0.0; JOINTS], TICK_S, &mut torque_nm);
        assert!((torque_nm[0] + 16.0).abs() < 0.01, "one step of 1000 N·m/s from -15: {torque_nm:?}");
        for _ in 0..100 {
            torque_nm = [-86.0; JOINTS];
            load.apply(ControlLaw::Impedance, None, &[0.0; JOINTS], TICK_S, &mut torque_nm);
        }
        assert!((torque_nm[0] + 87.0).abs() < 1e-9, "{torque_nm:?}");
    }

    #[test]
    fn arm_that_was_left_starts_from_no_torque_before() {
        let mut load = compensation();
        run(&mut load, ControlLaw::Hold, 15.0, 3.0);
        load.leave();
        let mut torque_nm = [40.0; JOINTS];
        load.apply(ControlLaw::Hold, None, &[0.0; JOINTS], TICK_S, &mut torque_nm);
        assert!((torque_nm[0] - 25.0).abs() < 0.01, "the load stays, the rate does not count: {torque_nm:?}");
    }

    fn with_friction() -> Compensation {
        let mut config = Config::default();
        config.control.compensation.friction_nm = vec![0.8, 0.0, 0.8, 0.8, 0.8, 0.8, 0.4];
        Compensation::new(&config, &config.parameters()).unwrap()
    }

    #[test]
    fn known_friction_is_commanded_against_along_the_speed() {
        let mut friction = with_friction();
        let dq_rad_s = [0.5, 0.5, -0.5, 0.01, 0.0, 0.0, -0.5, 0.0];
        let mut torque_nm = [1.0; JOINTS];
        friction.apply(ControlLaw::Impedance, Some(&[9.0; JOINTS]), &dq_rad_s, TICK_S, &mut torque_nm);
        let added_nm = torque_nm.map(|torque_nm| torque_nm - 1.0);
        for (added_nm, wanted_nm) in
            added_nm.iter().zip([0.8, 0.0, -0.8, 0.8 / 2.0_f64.sqrt(), 0.0, 0.0, -0.4, 0.0])
        {
            assert!((added_nm - wanted_nm).abs() < 1e-3, "{added_nm} instead of {wanted_nm} N·m");
        }
        assert!(friction.load_nm().iter().all(|load_nm| load_nm.abs() < 1e-12), "no load is learnt");
        let robot =
            RobotState { dq_rad_s, torque_measured_nm: torque_nm, ..RobotState::at_rest([0.0; JOINTS]) };
        let robot = friction.without_friction(&robot).unwrap();
        assert!(compensation().without_friction(&robot).is_none(), "none is known");
        assert!(
            robot.torque_measured_nm.iter().all(|torque_nm| (torque_nm - 1.0).abs() < 1e-12),
            "{robot:?}"
        );
    }

    /// The friction of the simulated arm, and of any arm whose friction rises faster with the speed, takes out more than is put in.
    #[test]
    fn known_friction_feeds_no_energy_into_an_arm_that_has_it() {
        let friction = with_friction();
        for exponent in -60..20 {
            let dq_rad_s = 10.0_f64.powf(0.1 * f64::from(exponent));
            let against_nm = friction.against_friction_nm(&[dq_rad_s; JOINTS])[0];
            let true_nm = 0.8 * dq_rad_s / dq_rad_s.hypot(1e-3);
            assert!(
                against_nm > 0.0 && against_nm <= true_nm,
                "{against_nm} of {true_nm} N·m at {dq_rad_s} rad/s"
            );
        }
    }
}
