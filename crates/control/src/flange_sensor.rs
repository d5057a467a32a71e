//! Force-torque sensor at the flange: from its readings to the external wrench that the laws are given. Pure.
//!
//! A sensor between flange and tool reads the external wrench, the weight of tool and load, and a bias. The weight follows from
//! their configured mass and centre of mass and from the flange's orientation. The bias is measured in a tare, while the arm stands.
//! Without a zero the laws use the momentum observer, and the robot cannot be armed.
//!
//! Without a sensor nothing is computed, and no bit of a command changes. A driver of one's own implements [`FlangeSensor`], and
//! [`crate::plant::Plant::flange_sensor`] gives it to the loop: `crates/daemon/examples/own_flange_sensor.rs` is one.

use crate::config::Config;
use crate::robot::{FlangeSensorKind, JOINTS};
use crate::supervisor::Zero;
use moca_msgs::mode::{FLANGE_TARE_NOISE, FLANGE_TARE_SPEED_RAD_S, FlangeTare};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{Fault, RobotState};
use moca_wbc::follow_me::moved;
use moca_wbc::model::GRAVITY_M_S2;
use moca_wbc::nalgebra::{Matrix3, Vector3};
use moca_wbc::rotation;
use serde::{Deserialize, Serialize};

/// Length of a tare, s.
pub const TARE_S: f64 = 0.5;
/// Fewest readings of a tare, however many ticks are missed.
const TARE_READINGS: f64 = 50.0;
/// Longest time with the same bits, s: noise changes them. ASSUMED: ten readings of a sensor with 100 of them a second.
pub const FROZEN_S: f64 = 0.1;

/// Newest reading of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlangeReading {
    /// Wrench on the flange from all that is beyond the sensor, its weight included: sensor's axes, about the sensor's origin
    /// \[N; N·m\].
    pub wrench: [f64; 6],
    /// Age of that wrench, s.
    pub age_s: f64,
}

/// A force-torque sensor between flange and tool.
pub trait FlangeSensor {
    /// Returns the newest reading and never waits; `None` before the first.
    fn latest(&mut self) -> Option<FlangeReading>;
}

/// External wrench at the flange from the readings of one sensor.
#[derive(Clone, Copy, Debug)]
pub struct FlangeWrench {
    joints: usize,
    /// Axes of the sensor in those of the flange.
    flange_from_sensor: Matrix3<f64>,
    /// Sensor in the flange's axes, m.
    position_flange: Vector3<f64>,
    /// Tool and load, flange's axes.
    payload: LinkInertial,
    /// Those and the object in the hand.
    carried: LinkInertial,
    deadline_s: f64,
    /// Largest magnitude of each axis.
    range: [f64; 6],
    state: FlangeState,
}

/// Memory of a [`FlangeWrench`] between ticks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlangeState {
    zero: FlangeZero,
    /// Last wrench in range, sensor's axes.
    last: [f64; 6],
    /// Time for which it has had the same bits, s.
    same_s: f64,
}

/// Zero of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum FlangeZero {
    /// Missing.
    Invalid(FlangeTare),
    /// Being measured.
    Taring(Tare),
    /// Wrench beside the weight that the sensor reads without a load, flange's axes about its origin \[N; N·m\].
    Valid([f64; 6]),
}

/// Readings of a tare so far, without the weight: flange's axes about its origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Tare {
    time_s: f64,
    count: f64,
    mean: [f64; 6],
    /// Sum of the squared deviations from the mean.
    squares: [f64; 6],
}

impl Tare {
    /// Takes in one reading (Welford's method).
    fn take(&mut self, wrench: &[f64; 6], dt_s: f64) {
        self.time_s += dt_s;
        self.count += 1.0;
        for ((mean, squares), value) in self.mean.iter_mut().zip(&mut self.squares).zip(wrench) {
            let off = value - *mean;
            *mean += off / self.count;
            *squares += off * (value - *mean);
        }
    }

    /// Returns the zero, or why it is missing.
    fn end(&self) -> FlangeZero {
        for (axis, (squares, most)) in (0..).zip(self.squares.iter().zip(axes(FLANGE_TARE_NOISE))) {
            let deviation = (squares / self.count).sqrt();
            if deviation > most {
                return FlangeZero::Invalid(FlangeTare::Noisy {
                    axis,
                    milli: milli(deviation).unsigned_abs(),
                });
            }
        }
        FlangeZero::Valid(self.mean)
    }
}

/// One value for each axis: forces and moments.
const fn axes([force_n, moment_nm]: [f64; 2]) -> [f64; 6] {
    [force_n, force_n, force_n, moment_nm, moment_nm, moment_nm]
}

/// Thousandths of a value; saturates.
fn milli(value: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    let milli = (1e3 * value).round() as i32;
    milli
}

impl FlangeWrench {
    /// As configured; `None` without a sensor or an arm.
    pub fn new(config: &Config) -> Option<Self> {
        let plant = &config.plant;
        let is_there = plant.flange_sensor != FlangeSensorKind::None && plant.parts.has_arm();
        let [x, y, z, roll, pitch, yaw] = plant.flange_sensor_origin;
        let zero = FlangeZero::Invalid(FlangeTare::Missing);
        let payload = config.robot.payload().inertial;
        is_there.then(|| Self {
            joints: config.arm().joints,
            flange_from_sensor: rotation::from_rpy([roll, pitch, yaw]),
            position_flange: Vector3::new(x, y, z),
            payload,
            carried: payload,
            deadline_s: plant.flange_sensor_deadline_s,
            range: axes(plant.flange_sensor_range),
            state: FlangeState { zero, last: [0.0; 6], same_s: 0.0 },
        })
    }

    /// Returns its memory.
    pub const fn state(&self) -> FlangeState {
        self.state
    }

    /// Goes on from where `state` was taken.
    pub const fn restore(&mut self, state: &FlangeState) {
        self.state = *state;
    }

    /// Knows of an object in the hand, flange's axes; one without mass is none.
    pub fn carry(&mut self, object: &LinkInertial) {
        self.carried = self.payload.with(object);
    }

    /// Begins a tare; the zero before it is void.
    pub fn start_tare(&mut self) {
        self.state.zero = FlangeZero::Taring(Tare::default());
    }

    /// Ends a tare without a zero: a reading or the robot's state is missing.
    pub const fn interrupt_tare(&mut self) {
        if matches!(self.state.zero, FlangeZero::Taring(_)) {
            self.state.zero = FlangeZero::Invalid(FlangeTare::Missing);
        }
    }

    /// Returns the state of the zero, with the fault that stands for a missing one.
    pub const fn zero(&self) -> (Zero, Fault) {
        let (zero, why) = match self.state.zero {
            FlangeZero::Invalid(FlangeTare::Missing) => (Zero::Invalid, FlangeTare::Missing),
            FlangeZero::Invalid(why) => (Zero::Refused, why),
            FlangeZero::Taring(_) => (Zero::Taring, FlangeTare::Missing),
            FlangeZero::Valid(_) => (Zero::Valid, FlangeTare::Missing),
        };
        (zero, Fault::FlangeZeroInvalid { why })
    }

    /// Weight of tool and load at the flange with these axes in W: flange's axes about its origin \[N; N·m\].
    fn weight(&self, flange_axes_world: &Matrix3<f64>) -> [f64; 6] {
        let down = flange_axes_world.transpose() * Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
        let weight = down * self.carried.mass_kg;
        moved(&[weight.x, weight.y, weight.z, 0.0, 0.0, 0.0], &Vector3::from(self.carried.com_m))
    }

    /// Lets a reading in that is new, in range and a number.
    fn checked(&mut self, reading: Option<FlangeReading>, dt_s: f64) -> Result<[f64; 6], Fault> {
        // an age that is not a number is none
        let fresh = reading.filter(|reading| reading.age_s <= self.deadline_s);
        let wrench = fresh.map(|reading| reading.wrench).ok_or(Fault::FlangeSensorStale)?;
        for (axis, (value, most)) in (0..).zip(wrench.into_iter().zip(self.range)) {
            if value.is_nan() {
                return Err(Fault::FlangeSensorStale);
            }
            if value.abs() > most {
                let milli_max = milli(most).unsigned_abs();
                return Err(Fault::FlangeSensorRange { axis, milli: milli(value), milli_max });
            }
        }
        let FlangeState { last, same_s, .. } = &mut self.state;
        *same_s = if wrench.map(f64::to_bits) == last.map(f64::to_bits) { *same_s + dt_s } else { 0.0 };
        *last = wrench;
        if *same_s > FROZEN_S { Err(Fault::FlangeSensorStale) } else { Ok(wrench) }
    }

    /// External wrench on the robot about the flange's origin, world axes \[N; N·m\], from a reading `dt_s` after the last one.
    /// `None` without a zero. `flange_axes_world` are the flange's axes in W.
    ///
    /// # Errors
    /// [`Fault::FlangeSensorStale`] for a reading that is missing, too old, not a number, or the same for longer than [`FROZEN_S`];
    /// [`Fault::FlangeSensorRange`]. Both interrupt a tare.
    pub fn feel(
        &mut self,
        reading: Option<FlangeReading>,
        robot: &RobotState<JOINTS>,
        flange_axes_world: &Matrix3<f64>,
        dt_s: f64,
    ) -> Result<Option<[f64; 6]>, Fault> {
        let wrench = self.checked(reading, dt_s).inspect_err(|_| self.interrupt_tare())?;
        let about_flange = moved(&rotation::turned(&self.flange_from_sensor, &wrench), &self.position_flange);
        let weight = self.weight(flange_axes_world);
        let unloaded = std::array::from_fn(|i| about_flange[i] - weight[i]);
        if let FlangeZero::Taring(tare) = &mut self.state.zero {
            tare.take(&unloaded, dt_s);
            let speeds = (0..).zip(&robot.dq_rad_s[..self.joints]).map(|(joint, dq)| (joint, dq.abs()));
            let fastest = speeds.max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((joint, speed)) = fastest.filter(|(_, speed)| *speed > FLANGE_TARE_SPEED_RAD_S) {
                let mrad_s = milli(speed).unsigned_abs();
                self.state.zero = FlangeZero::Invalid(FlangeTare::Moved { joint, mrad_s });
            } else if tare.time_s >= TARE_S && tare.count >= TARE_READINGS {
                self.state.zero = tare.end();
            }
        }
        let FlangeZero::Valid(bias) = &self.state.zero else { return Ok(None) };
        let external = std::array::from_fn(|i| unloaded[i] - bias[i]);
        Ok(Some(rotation::turned(flange_axes_world, &external)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_wbc::nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};

    const DT_S: f64 = 1e-3;
    const TICKS: usize = 500;
    const BIAS: [f64; 6] = [12.0, -7.0, 30.0, 0.5, -0.2, 0.1];
    const TOOL_KG: f64 = 1.5;
    const TOOL_COM_M: [f64; 3] = [0.02, -0.01, 0.08];
    const ORIGIN: [f64; 6] = [0.005, 0.0, 0.04, 0.0, 0.0, 0.8];

    fn config() -> Config {
        let mut config = Config::default();
        config.plant.flange_sensor = FlangeSensorKind::Simulated;
        config.plant.flange_sensor_origin = ORIGIN;
        (config.robot.tool.mass_kg, config.robot.tool.com_m) = (TOOL_KG, TOOL_COM_M);
        config
    }

    fn standing() -> RobotState<JOINTS> {
        RobotState::at_rest([0.3; JOINTS])
    }

    /// A reading with rigid-body transforms of nalgebra instead of ours: point forces on the tool, taken about the sensor.
    fn reading(
        axes_world: &UnitQuaternion<f64>,
        push_world: Vector3<f64>,
        at_flange: Point3<f64>,
    ) -> [f64; 6] {
        let [x, y, z, roll, pitch, yaw] = ORIGIN;
        let sensor = Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        );
        let forces = [
            (axes_world.inverse() * push_world, at_flange),
            (axes_world.inverse() * Vector3::new(0.0, 0.0, -9.81 * TOOL_KG), Point3::from(TOOL_COM_M)),
        ];
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for (pushed, at) in forces {
            let (pushed, at) = (sensor.rotation.inverse() * pushed, sensor.inverse() * at);
            force += pushed;
            moment += at.coords.cross(&pushed);
        }
        let ideal = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
        std::array::from_fn(|i| ideal[i] + BIAS[i])
    }

    fn fresh(wrench: [f64; 6]) -> Option<FlangeReading> {
        Some(FlangeReading { wrench, age_s: 0.001 })
    }

    fn matrix(axes: &UnitQuaternion<f64>) -> Matrix3<f64> {
        axes.to_rotation_matrix().into_inner()
    }

    /// A tare at rest with these deviations from reading to reading; without any a sensor counts as frozen.
    fn tare(sensor: &mut FlangeWrench, axes: &UnitQuaternion<f64>, deviations: [f64; 6]) {
        let unpushed = reading(axes, Vector3::zeros(), Point3::origin());
        sensor.start_tare();
        for tick in 0..=TICKS {
            let sign = if tick.is_multiple_of(2) { 1.0 } else { -1.0 };
            let noisy = std::array::from_fn(|i| unpushed[i] + sign * deviations[i]);
            let _ = sensor.feel(fresh(noisy), &standing(), &matrix(axes), DT_S).unwrap();
        }
    }

    fn tared(axes: &UnitQuaternion<f64>) -> FlangeWrench {
        let mut sensor = FlangeWrench::new(&config()).unwrap();
        tare(&mut sensor, axes, [1e-9; 6]);
        assert_eq!(sensor.zero().0, Zero::Valid);
        sensor
    }

    #[test]
    fn no_sensor_or_no_arm_computes_nothing() {
        assert!(FlangeWrench::new(&Config::default()).is_none());
        let mut alone = config();
        alone.plant.parts = crate::robot::Parts::Base;
        assert!(FlangeWrench::new(&alone).is_none());
    }

    #[test]
    fn weight_of_tool_is_taken_out_at_every_orientation() {
        let down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
        let sensor = tared(&down);
        let turns = [[0.0, 0.0, 0.0], [1.2, 0.4, -2.0], [-0.7, 1.5, 0.3], [3.0, -0.2, 1.0]];
        for [roll, pitch, yaw] in turns {
            let axes = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
            let (push, at) = (Vector3::new(15.0, -4.0, 6.0), Point3::new(0.01, 0.03, 0.15));
            let mut sensor = sensor;
            let felt = sensor.feel(fresh(reading(&axes, push, at)), &standing(), &matrix(&axes), DT_S);
            let moment = (axes * at.coords).cross(&push);
            let expected = [push.x, push.y, push.z, moment.x, moment.y, moment.z];
            for (felt, expected) in felt.unwrap().unwrap().iter().zip(expected) {
                assert!((felt - expected).abs() < 1e-9, "{roll} {pitch} {yaw}: {felt} {expected}");
            }
        }
    }

    #[test]
    fn no_wrench_passes_before_a_tare() {
        let axes = UnitQuaternion::identity();
        let mut sensor = FlangeWrench::new(&config()).unwrap();
        let missing = Fault::FlangeZeroInvalid { why: FlangeTare::Missing };
        assert_eq!(sensor.zero(), (Zero::Invalid, missing));
        let unpushed = reading(&axes, Vector3::zeros(), Point3::origin());
        assert_eq!(sensor.feel(fresh(unpushed), &standing(), &matrix(&axes), DT_S), Ok(None));
        let mut sensor = tared(&axes);
        sensor.start_tare();
        assert_eq!(sensor.feel(fresh(unpushed), &standing(), &matrix(&axes), DT_S), Ok(None));
    }

    #[test]
    fn motion_during_tare_is_refused_with_value_and_range() {
        let axes = UnitQuaternion::identity();
        let unpushed = reading(&axes, Vector3::zeros(), Point3::origin());
        let mut sensor = FlangeWrench::new(&config()).unwrap();
        let mut moving = standing();
        moving.dq_rad_s[2] = -FLANGE_TARE_SPEED_RAD_S;
        sensor.start_tare();
        let _ = sensor.feel(fresh(unpushed), &moving, &matrix(&axes), DT_S).unwrap();
        assert_eq!(sensor.zero().0, Zero::Taring, "at its limit");
        moving.dq_rad_s[2] = -0.12;
        let _ = sensor.feel(fresh(unpushed), &moving, &matrix(&axes), DT_S).unwrap();
        let (zero, fault) = sensor.zero();
        let why = FlangeTare::Moved { joint: 2, mrad_s: 120 };
        assert_eq!((zero, fault), (Zero::Refused, Fault::FlangeZeroInvalid { why }));
        let said = fault.to_string();
        assert!(said.contains("Joint 3 moved at 0.120 rad/s") && said.contains("0 to 0.02 rad/s"), "{said}");
    }

    #[test]
    fn noise_during_tare_is_refused_with_value_and_range() {
        let axes = UnitQuaternion::identity();
        for (axis, name) in ["fx", "fy", "fz", "mx", "my", "mz"].into_iter().enumerate() {
            let (most, unit) = if axis < 3 { (3.0, "N") } else { (0.3, "N·m") };
            for (share, zero) in [(0.99, Zero::Valid), (1.01, Zero::Refused)] {
                let mut origin = config();
                origin.plant.flange_sensor_origin = [0.0; 6];
                let mut sensor = FlangeWrench::new(&origin).unwrap();
                let mut deviations = [1e-6; 6];
                deviations[axis] = share * most;
                tare(&mut sensor, &axes, deviations);
                let (found, fault) = sensor.zero();
                assert_eq!(found, zero, "{share} of the limit of {name}");
                let value = share * most;
                let said = format!(
                    "{name} of the flange sensor varied by {value:.3} {unit} during its tare; allowed: 0 to {most} {unit}."
                );
                assert!(zero == Zero::Valid || fault.to_string().starts_with(&said), "{fault}");
            }
        }
    }

    #[test]
    fn steady_noise_averages_into_the_zero() {
        let axes = UnitQuaternion::identity();
        let mut sensor = FlangeWrench::new(&config()).unwrap();
        tare(&mut sensor, &axes, [0.05; 6]);
        let unpushed = reading(&axes, Vector3::zeros(), Point3::origin());
        let felt = sensor.feel(fresh(unpushed), &standing(), &matrix(&axes), DT_S).unwrap().unwrap();
        // one reading more with the one sign than with the other
        assert!(felt.iter().all(|value| value.abs() < 1e-3), "{felt:?}");
    }

    #[test]
    fn missing_old_or_nan_reading_is_stale_and_never_zero() {
        let axes = UnitQuaternion::identity();
        let unpushed = reading(&axes, Vector3::zeros(), Point3::origin());
        let deadline_s = config().plant.flange_sensor_deadline_s;
        let aged = |age_s| Some(FlangeReading { wrench: unpushed, age_s });
        let mut bad: Vec<_> = [1.001 * deadline_s, f64::NAN, f64::INFINITY].map(aged).into();
        bad.push(None);
        bad.extend((0..6).map(|axis| {
            let mut wrench = unpushed;
            wrench[axis] = f64::NAN;
            fresh(wrench)
        }));
        for bad in bad {
            let mut sensor = tared(&axes);
            let mut feel = |reading| sensor.feel(reading, &standing(), &matrix(&axes), DT_S);
            assert!(feel(aged(deadline_s)).unwrap().is_some(), "at its deadline");
            assert_eq!(feel(bad), Err(Fault::FlangeSensorStale), "{bad:?}");
            assert!(feel(aged(0.0)).unwrap().is_some(), "it does not void the zero");
            sensor.start_tare();
            assert_eq!(sensor.feel(bad, &standing(), &matrix(&axes), DT_S), Err(Fault::FlangeSensorStale));
            assert_eq!(sensor.zero().0, Zero::Invalid, "it interrupts a tare");
        }
    }

    #[test]
    fn same_bits_for_too_long_are_stale_until_they_change() {
        let axes = UnitQuaternion::identity();
        let mut sensor = tared(&axes);
        let unpushed = reading(&axes, Vector3::zeros(), Point3::origin());
        let mut feel = |wrench| sensor.feel(fresh(wrench), &standing(), &matrix(&axes), 0.01);
        for axis in 0..6 {
            let mut wrench = unpushed;
            wrench[axis] += 1e-6;
            for repeat in 0..=10 {
                assert!(feel(wrench).unwrap().is_some(), "axis {axis}, repeat {repeat}");
            }
            for _ in 0..20 {
                assert_eq!(feel(wrench), Err(Fault::FlangeSensorStale), "axis {axis}");
            }
        }
    }

    #[test]
    fn reading_outside_range_is_refused_with_value_and_range() {
        let axes = UnitQuaternion::identity();
        let mut config = config();
        config.plant.flange_sensor_range = [100.0, 12.5];
        for (axis, value, said) in [
            (0, 100.5, "read fx = 100.500 N; its range: -100 to 100 N."),
            (2, -250.0, "read fz = -250.000 N; its range: -100 to 100 N."),
            (4, -13.0, "read my = -13.000 N·m; its range: -12.5 to 12.5 N·m."),
            (5, f64::INFINITY, "read mz = 2147483.647 N·m"),
            (1, f64::NEG_INFINITY, "read fy = -2147483.648 N;"),
        ] {
            let mut sensor = FlangeWrench::new(&config).unwrap();
            let mut wrench = [0.0; 6];
            wrench[axis] = if axis < 3 { 100.0 } else { -12.5 };
            assert_eq!(sensor.feel(fresh(wrench), &standing(), &matrix(&axes), DT_S), Ok(None), "in range");
            wrench[axis] = value;
            sensor.start_tare();
            let fault = sensor.feel(fresh(wrench), &standing(), &matrix(&axes), DT_S).unwrap_err();
            assert!(fault.to_string().contains(said), "{fault}");
            assert_eq!(sensor.zero().0, Zero::Invalid, "it interrupts a tare");
        }
    }

    #[test]
    fn tare_over_missed_ticks_still_takes_50_readings() {
        let axes = UnitQuaternion::identity();
        let mut sensor = FlangeWrench::new(&config()).unwrap();
        sensor.start_tare();
        for tick in 1..=50 {
            assert_eq!(sensor.zero().0, Zero::Taring, "{tick}");
            let wobbling =
                reading(&axes, Vector3::zeros(), Point3::origin()).map(|x| x + 1e-3 * f64::from(tick));
            let _ = sensor.feel(fresh(wobbling), &standing(), &matrix(&axes), 0.1).unwrap();
        }
        assert_eq!(sensor.zero().0, Zero::Valid);
    }

    #[test]
    fn restored_sensor_goes_on_with_same_bits() {
        let axes = UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1);
        let unpushed = reading(&axes, Vector3::zeros(), Point3::origin());
        let wobbling = |tick: usize| {
            fresh(unpushed.map(|value| value + if tick.is_multiple_of(3) { 1e-3 } else { 0.0 }))
        };
        let mut sensor = FlangeWrench::new(&config()).unwrap();
        sensor.start_tare();
        for tick in 0..TICKS / 2 {
            let _ = sensor.feel(wobbling(tick), &standing(), &matrix(&axes), DT_S).unwrap();
        }
        let mut other = FlangeWrench::new(&config()).unwrap();
        other.restore(&sensor.state());
        for tick in 0..TICKS {
            let felt = sensor.feel(wobbling(tick), &standing(), &matrix(&axes), DT_S);
            assert_eq!(felt, other.feel(wobbling(tick), &standing(), &matrix(&axes), DT_S));
        }
        assert_eq!((sensor.zero().0, other.zero().0), (Zero::Valid, Zero::Valid));
    }
}
