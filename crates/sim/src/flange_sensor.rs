//! Force-torque sensor between flange and payload: its readings, with their errors.
//!
//! It carries the true payload, so it reads the wrench on the robot beyond it and that payload's weight. The inertia of an
//! accelerated payload is left out.

use crate::SimError;
use crate::base_link::ticks;
use crate::error::within;
use crate::sensor::Noise;
use moca_msgs::TrueFlangeSensor;
use moca_msgs::robot::LinkInertial;
use moca_wbc::follow_me::moved;
use moca_wbc::model::GRAVITY_M_S2;
use moca_wbc::nalgebra::{Matrix3, Vector3};
use moca_wbc::rotation;
use std::collections::VecDeque;

/// Stream of the noise: apart from the others of the same seed.
const STREAM: u64 = 0x666c_616e;

/// Sensor of one flange. Nothing is allocated after the start.
#[derive(Debug)]
pub(crate) struct FlangeSensor {
    truth: TrueFlangeSensor,
    /// Axes of the sensor in those of the flange.
    flange_from_sensor: Matrix3<f64>,
    /// Sensor in the flange's axes, m.
    position_flange: Vector3<f64>,
    payload: LinkInertial,
    period_s: f64,
    /// Control periods so far.
    periods: f64,
    noise: Noise,
    /// The newest reading that has arrived, and those on their way.
    readings: VecDeque<[f64; 6]>,
    /// Number of them.
    count: usize,
}

impl FlangeSensor {
    /// Checks the numbers of a sensor.
    pub(crate) fn check(truth: &TrueFlangeSensor, origin: Option<&[f64; 6]>) -> Result<(), SimError> {
        let TrueFlangeSensor { bias_n, bias_nm, noise_n, noise_nm, drift_n_s, drift_nm_s, delay_ms } = truth;
        within("true.flange_sensor.bias_n", "N", bias_n, -200.0, 200.0)?;
        within("true.flange_sensor.bias_nm", "N·m", bias_nm, -20.0, 20.0)?;
        within("true.flange_sensor.noise_n", "N", &[*noise_n], 1e-4, 50.0)?;
        within("true.flange_sensor.noise_nm", "N·m", &[*noise_nm], 1e-5, 5.0)?;
        within("true.flange_sensor.drift_n_s", "N/s", &[*drift_n_s], -10.0, 10.0)?;
        within("true.flange_sensor.drift_nm_s", "N·m/s", &[*drift_nm_s], -1.0, 1.0)?;
        within("true.flange_sensor.delay_ms", "ms", &[*delay_ms], 0.0, 1000.0)?;
        origin.map_or(Ok(()), |origin| within("flange_sensor_origin", "m, rad", origin, -7.0, 7.0))
    }

    /// Sensor at `origin` under `payload`, which is in the flange's axes, with a reading every `period_s`.
    pub(crate) fn new(
        truth: &TrueFlangeSensor,
        origin: &[f64; 6],
        payload: LinkInertial,
        period_s: f64,
        seed: u64,
    ) -> Self {
        let [x, y, z, roll, pitch, yaw] = *origin;
        let count = ticks(truth.delay_ms, period_s) + 1;
        Self {
            truth: *truth,
            flange_from_sensor: rotation::from_rpy([roll, pitch, yaw]),
            position_flange: Vector3::new(x, y, z),
            payload,
            period_s,
            periods: 0.0,
            noise: Noise::new(STREAM.wrapping_add(seed)),
            readings: VecDeque::with_capacity(count + 1),
            count,
        }
    }

    /// Another payload hangs on it from now on.
    pub(crate) const fn carry(&mut self, payload: LinkInertial) {
        self.payload = payload;
    }

    /// Measures once a control period: an external wrench about the flange's origin, world axes, with the flange's axes in W.
    pub(crate) fn measure(&mut self, wrench_world: &[f64; 6], flange_axes_world: &Matrix3<f64>) {
        let time_s = self.periods * self.period_s;
        self.periods += 1.0;
        let mut reading = self.ideal(wrench_world, flange_axes_world);
        let TrueFlangeSensor { bias_n, bias_nm, noise_n, noise_nm, drift_n_s, drift_nm_s, .. } = self.truth;
        let (force, moment) = reading.split_at_mut(3);
        for (values, bias, drift, noise) in
            [(force, bias_n, drift_n_s, noise_n), (moment, bias_nm, drift_nm_s, noise_nm)]
        {
            for (value, bias) in values.iter_mut().zip(bias) {
                *value += bias + drift * time_s + noise * self.noise.standard_normal();
            }
        }
        self.readings.push_back(reading);
        if self.readings.len() > self.count {
            self.readings.pop_front();
        }
    }

    /// Number of measurements until the first of them arrives.
    pub(crate) const fn count(&self) -> usize {
        self.count
    }

    /// Returns the newest reading that has arrived: N and N·m in the sensor's axes about its origin.
    pub(crate) fn latest(&self) -> Option<[f64; 6]> {
        self.readings.front().copied()
    }

    /// Returns the reading of a sensor without errors.
    fn ideal(&self, wrench_world: &[f64; 6], flange_axes_world: &Matrix3<f64>) -> [f64; 6] {
        let [fx, fy, fz, mx, my, mz] = rotation::turned(&flange_axes_world.transpose(), wrench_world);
        let down = flange_axes_world.transpose() * Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
        let weight = down * self.payload.mass_kg;
        let tilting = Vector3::from(self.payload.com_m).cross(&weight);
        let loaded =
            [fx + weight.x, fy + weight.y, fz + weight.z, mx + tilting.x, my + tilting.y, mz + tilting.z];
        let about_sensor = moved(&loaded, &-self.position_flange);
        rotation::turned(&self.flange_from_sensor.transpose(), &about_sensor)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Engine, Scene, SimPlant};
    use moca_msgs::TrueFlangeSensor;
    use moca_msgs::robot::{AnyArm, LinkInertial, MOCA_MOUNT, PANDA, PAPER_COVER, Payload, SUMMIT_XL};
    use moca_wbc::nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

    const TOOL: LinkInertial =
        LinkInertial { mass_kg: 2.0, com_m: [0.03, -0.02, 0.1], inertia_com: [0.0; 6] };
    const ORIGIN: [f64; 6] = [0.01, -0.02, 0.04, 0.2, -0.3, 0.5];
    const QUIET: TrueFlangeSensor = TrueFlangeSensor {
        bias_n: [0.0; 3],
        bias_nm: [0.0; 3],
        noise_n: 1e-4,
        noise_nm: 1e-5,
        drift_n_s: 0.0,
        drift_nm_s: 0.0,
        delay_ms: 0.0,
    };

    fn scene(truth: TrueFlangeSensor, engine: Engine) -> Scene {
        Scene {
            engine,
            payload: Payload { inertial: TOOL, tool_origin: [0.0, 0.0, 0.1, 0.3, -0.2, 0.7] },
            flange_sensor_origin: Some(ORIGIN),
            flange_truth: truth,
            ..Scene::new(&AnyArm::of(&PANDA), &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER)
        }
    }

    fn plant(truth: TrueFlangeSensor) -> SimPlant {
        SimPlant::new(&scene(truth, Engine::Analytic)).unwrap()
    }

    /// One control period in which the robot stands.
    fn stand(plant: &mut SimPlant) {
        let start = plant.state();
        plant.step().unwrap();
        plant.set_state(&[0.0; 3], &[0.0; 3], &start.q_rad, &[0.0; 8]);
    }

    /// Wrench on the sensor with nalgebra's rigid-body transforms: the hand about the flange and the tool's weight.
    fn expected(axes: &Rotation3<f64>, hand: &[f64; 6]) -> [f64; 6] {
        let [x, y, z, roll, pitch, yaw] = ORIGIN;
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let sensor = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        let [fx, fy, fz, mx, my, mz] = *hand;
        let mut moment = (axes * sensor.rotation).inverse() * Vector3::new(mx, my, mz);
        let mut force = Vector3::zeros();
        let weight = (Vector3::new(0.0, 0.0, -9.81 * TOOL.mass_kg), Point3::from(TOOL.com_m));
        for (push_world, at) in [(Vector3::new(fx, fy, fz), Point3::origin()), weight] {
            let push = sensor.rotation.inverse() * (axes.inverse() * push_world);
            force += push;
            moment += sensor.inverse_transform_point(&at).coords.cross(&push);
        }
        [force.x, force.y, force.z, moment.x, moment.y, moment.z]
    }

    #[test]
    fn engines_read_hand_and_weight_about_turned_sensor() {
        let hand = [7.0, -3.0, 4.0, 0.5, -0.6, 0.7];
        for engine in [Engine::MuJoCo, Engine::Analytic] {
            let mut plant = SimPlant::new(&scene(QUIET, engine)).unwrap();
            plant.set_flange_wrench_world(hand).unwrap();
            stand(&mut plant);
            let axes = plant.mechanics.flange_pose().unwrap().axes();
            let expected = expected(&Rotation3::from_matrix_unchecked(axes), &hand);
            let reading = plant.flange_reading().unwrap();
            for (read, expected) in reading.iter().zip(expected) {
                assert!((read - expected).abs() < 1e-3, "{engine:?} {reading:?} {expected:?}");
            }
        }
    }

    #[test]
    fn bias_and_noise_are_added_to_reading() {
        let truth = TrueFlangeSensor {
            bias_n: [3.0, -4.0, 5.0],
            bias_nm: [0.1, 0.2, -0.3],
            noise_n: 0.5,
            noise_nm: 0.02,
            ..QUIET
        };
        let (mut exact, mut plant) = (plant(QUIET), plant(truth));
        let (mut sums, mut squares, periods) = ([0.0; 6], [0.0; 6], 2000);
        for _ in 0..periods {
            for plant in [&mut exact, &mut plant] {
                stand(plant);
            }
            let (exact, reading) = (exact.flange_reading().unwrap(), plant.flange_reading().unwrap());
            for i in 0..6 {
                let off = reading[i] - exact[i] - [3.0, -4.0, 5.0, 0.1, 0.2, -0.3][i];
                sums[i] += off;
                squares[i] += off * off;
            }
        }
        for (i, deviation) in [0.5, 0.5, 0.5, 0.02, 0.02, 0.02].into_iter().enumerate() {
            let (mean, found) = (sums[i] / f64::from(periods), (squares[i] / f64::from(periods)).sqrt());
            assert!(mean.abs() < 0.1 * deviation, "axis {i}: mean {mean}");
            assert!((found / deviation - 1.0).abs() < 0.06, "axis {i}: {found}");
        }
    }

    #[test]
    fn bias_drifts_with_time() {
        let mut drifting = plant(TrueFlangeSensor { drift_n_s: 2.0, drift_nm_s: -0.5, ..QUIET });
        let mut exact = plant(QUIET);
        for tick in 0..1000 {
            for plant in [&mut exact, &mut drifting] {
                stand(plant);
            }
            let (exact, reading) = (exact.flange_reading().unwrap(), drifting.flange_reading().unwrap());
            let time_s = 1e-3 * f64::from(tick + 1);
            for i in 0..6 {
                let drift = if i < 3 { 2.0 } else { -0.5 } * time_s;
                assert!((reading[i] - exact[i] - drift).abs() < 1e-9, "axis {i} at {time_s} s");
            }
        }
    }

    #[test]
    fn delayed_reading_is_that_of_earlier_period() {
        let (mut exact, mut late) = (plant(QUIET), plant(TrueFlangeSensor { delay_ms: 7.0, ..QUIET }));
        let mut readings = vec![exact.flange_reading().unwrap(); 7];
        for tick in 0..50 {
            for plant in [&mut exact, &mut late] {
                plant.set_flange_wrench_world([f64::from(tick), 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
                stand(plant);
            }
            readings.push(exact.flange_reading().unwrap());
            let expected = readings[readings.len() - 8];
            for (read, expected) in late.flange_reading().unwrap().iter().zip(expected) {
                assert!((read - expected).abs() < 2e-3, "tick {tick}: {read} {expected}");
            }
        }
    }

    #[test]
    fn sensor_outside_range_is_refused_with_name_and_unit() {
        let refused = |truth, name: &str, unit: &str| {
            let said = SimPlant::new(&scene(truth, Engine::Analytic)).unwrap_err().to_string();
            assert!(said.contains(&format!("true.flange_sensor.{name} = ")), "{said}");
            assert!(said.ends_with(&format!(" {unit}")), "{said}");
        };
        for bad in [-201.0, f64::NAN] {
            refused(TrueFlangeSensor { bias_n: [0.0, bad, 0.0], ..QUIET }, "bias_n", "N");
            refused(TrueFlangeSensor { bias_nm: [0.0, 0.0, bad], ..QUIET }, "bias_nm", "N·m");
            refused(TrueFlangeSensor { noise_n: bad, ..QUIET }, "noise_n", "N");
            refused(TrueFlangeSensor { noise_nm: bad, ..QUIET }, "noise_nm", "N·m");
            refused(TrueFlangeSensor { drift_n_s: bad, ..QUIET }, "drift_n_s", "N/s");
            refused(TrueFlangeSensor { drift_nm_s: bad, ..QUIET }, "drift_nm_s", "N·m/s");
            refused(TrueFlangeSensor { delay_ms: bad, ..QUIET }, "delay_ms", "ms");
        }
        let off = Scene {
            flange_sensor_origin: Some([0.0, 0.0, 0.0, 0.0, 7.1, 0.0]),
            ..scene(QUIET, Engine::Analytic)
        };
        let said = SimPlant::new(&off).unwrap_err().to_string();
        assert!(said.contains("flange_sensor_origin = 7.1 m, rad"), "{said}");
    }

    #[test]
    fn scene_without_sensor_reads_nothing() {
        let plain = Scene { flange_sensor_origin: None, ..scene(QUIET, Engine::Analytic) };
        let mut plant = SimPlant::new(&plain).unwrap();
        stand(&mut plant);
        assert_eq!(plant.flange_reading(), None);
    }
}
