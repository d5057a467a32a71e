//! The contact barrier in the loop: from the cover's readings and their age to what the base may still do.

use crate::config::{BarrierReadings, Config};
use crate::control::cover::CoverState;
use crate::robot::{JOINTS, TAXELS};
use moca_msgs::robot::resized;
use moca_msgs::{ParameterError, RobotState, TaxelStatus};
use moca_wbc::contact_barrier::{
    BarrierInput, BarrierSettings, BarrierState, ContactBarrier, ContactLimits, FoamCurve, TaxelSample,
};
use moca_wbc::{ArmModel, ControlError, FlangePose};
use serde::{Deserialize, Serialize};

/// PU LD30's elastic law, which an uncalibrated cover is read with.
const PU_LD30: FoamCurve = FoamCurve::Power { depth_at_100n_m: 0.0114, exponent: 1.586 };

/// The barrier with what a tick tells it piece by piece.
#[derive(Clone, Debug)]
pub struct Barrier {
    contacts: ContactBarrier<TAXELS>,
    samples: [Option<TaxelSample>; TAXELS],
    /// Flange from the base with the arm in its posture, axes of B, m; of an arm that holds its place in the world.
    home_body_m: Option<[f64; 2]>,
    /// Flange from the base in the last tick, axes of B, m.
    flange_body_m: Option<[f64; 2]>,
}

/// What a [`Barrier`] remembers from tick to tick.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BarrierMemory {
    contacts: BarrierState<TAXELS>,
    flange_body_m: Option<[f64; 2]>,
}

impl Barrier {
    /// As configured; `None` where there is none.
    ///
    /// # Errors
    /// A foam, a force limit or a taxel's place out of range.
    pub fn new<const N: usize>(
        config: &Config,
        arm: Option<&ArmModel<N, f64>>,
    ) -> Result<Option<Self>, ParameterError> {
        let Some(settings) = settings(config)? else { return Ok(None) };
        let posture_rad = resized(&config.parameters().gains.posture_rad);
        let home = arm.map(|model| model.kinematics(0.0, &posture_rad).tool_from_base());
        Ok(Some(Self {
            contacts: ContactBarrier::new(&config.robot.cover.placements(), &settings)?,
            samples: [None; TAXELS],
            home_body_m: home.map(|home| [home.x, home.y]),
            flange_body_m: None,
        }))
    }

    /// What it remembers.
    pub fn state(&self) -> BarrierMemory {
        BarrierMemory { contacts: self.contacts.state().clone(), flange_body_m: self.flange_body_m }
    }

    /// Goes on from where `state` was taken.
    pub fn restore(&mut self, state: &BarrierMemory) {
        self.contacts.restore(&state.contacts);
        self.flange_body_m = state.flange_body_m;
    }

    /// Takes in what the cover says in the tick at `now_ns`.
    pub fn take_cover(&mut self, now_ns: u64, cover: &CoverState) {
        let age_s = cover.reading.age_s(now_ns);
        for (sample, taxel) in self.samples.iter_mut().zip(&cover.reading.taxels) {
            let valid = taxel.status == TaxelStatus::Ok;
            *sample = age_s.filter(|_| valid).map(|age_s| TaxelSample { force_n: taxel.force_n, age_s });
        }
    }

    /// What the contacts allow in this tick. `holds_place`: the flange stays where it is in the world.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn update(
        &mut self,
        robot: &RobotState<JOINTS>,
        deceleration: [f64; 3],
        holds_place: bool,
        dt_s: f64,
    ) -> Result<ContactLimits<TAXELS>, ControlError> {
        let [vx, vy, yaw] = robot.base_velocity_world;
        let [vx, vy] = to_base([vx, vy], robot);
        let mut input = BarrierInput::new(self.samples, [vx, vy, yaw], deceleration, dt_s);
        if let (true, Some(home), Some(flange)) = (holds_place, self.home_body_m, self.flange_body_m) {
            input.stretch_body_m = [flange[0] - home[0], flange[1] - home[1]];
        }
        self.contacts.update(&input)
    }

    /// Where the flange was in this tick.
    pub fn remember(&mut self, flange: &FlangePose, robot: &RobotState<JOINTS>) {
        let [x, y, _] = flange.position_world;
        let [base_x, base_y, _] = robot.base_pose_world;
        self.flange_body_m = Some(to_base([x - base_x, y - base_y], robot));
    }
}

fn to_base([x, y]: [f64; 2], robot: &RobotState<JOINTS>) -> [f64; 2] {
    let (sin, cos) = robot.base_pose_world[2].sin_cos();
    [cos * x + sin * y, cos * y - sin * x]
}

fn curves(config: &Config) -> Option<(FoamCurve, FoamCurve)> {
    let p = &config.protection;
    let foam = FoamCurve::Hyperbolic { stiffness_n_m: p.foam_stiffness_n_m, thickness_m: p.foam_thickness_m };
    match p.contact_barrier {
        BarrierReadings::Off => None,
        BarrierReadings::Foam => Some((foam, foam)),
        BarrierReadings::PuLd30 => Some((PU_LD30, foam)),
    }
}

fn settings(config: &Config) -> Result<Option<BarrierSettings>, ParameterError> {
    let servo_s = config.robot.base.servo_time_constant_s;
    curves(config)
        .map(|(reading, foam)| BarrierSettings::new(reading, foam, config.protection.force_limit_n, servo_s))
        .transpose()
}

/// Way that the foam alone yields between what the cover hides and the force limit, m: what a base under a barrier has
/// to stop in. `None` without a barrier.
pub fn travel_m(config: &Config) -> Option<f64> {
    let p = &config.protection;
    let (reading, foam) = curves(config)?;
    Some((foam.depth_m(p.force_limit_n) - reading.depth_m(p.threshold_force_n)).max(0.0))
}
