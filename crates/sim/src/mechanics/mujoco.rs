//! MuJoCo: whatever a scene holds.

use super::Mechanics;
use crate::gripper::FlangePose;
use crate::mjcf::{FLANGE, LOAD, mjcf};
use crate::{ModelSize, Robot, Scene, SimError, quiet};
use moca_msgs::robot::LinkInertial;
use mujoco_rs::prelude::{MjData, MjModel, MjtWarning};

#[derive(Debug)]
pub(super) struct MuJoCo {
    data: MjData<Box<MjModel>>,
    flange_body: Option<usize>,
    load_body: Option<usize>,
    /// Touch sensors, which come first of all sensors.
    touch_sensors: usize,
    /// Scratch for the dense mass matrix, nv × nv.
    mass: Vec<f64>,
}

impl MuJoCo {
    pub(super) fn new(scene: &Scene) -> Result<Self, SimError> {
        quiet::install();
        let xml = mjcf(scene).map_err(|error| SimError::Model(error.to_string()))?;
        let refused = |error: &dyn std::fmt::Display| SimError::Model(error.to_string());
        let model = MjModel::from_xml_string(&xml).map_err(|error| refused(&error))?;
        let nv = usize::try_from(model.ffi().nv).unwrap_or(0);
        let flange_body = model.body(FLANGE).map(|info| info.id);
        let load_body = model.body(LOAD).map(|info| info.id);
        let data = MjData::try_new(Box::new(model)).map_err(|error| refused(&error))?;
        let touch_sensors = if scene.geoms && scene.robot != Robot::ArmOnly { scene.cover.len() } else { 0 };
        Ok(Self { data, flange_body, load_body, touch_sensors, mass: vec![0.0; nv * nv] })
    }

    fn check(&self) -> Result<(), SimError> {
        const WATCHED: [(MjtWarning, &str); 6] = [
            (MjtWarning::mjWARN_BADQPOS, super::BAD_POSITION),
            (MjtWarning::mjWARN_BADQVEL, super::BAD_RATE),
            (MjtWarning::mjWARN_BADQACC, super::BAD_ACCELERATION),
            (MjtWarning::mjWARN_INERTIA, super::SINGULAR),
            (MjtWarning::mjWARN_CONTACTFULL, "the contact buffer is full"),
            (MjtWarning::mjWARN_CNSTRFULL, "the constraint buffer is full"),
        ];
        let raised = self.data.warning();
        match WATCHED.iter().find(|(kind, _)| raised[*kind as usize].number > 0) {
            Some((_, warning)) => Err(SimError::Unstable { warning, time_s: self.data.time() }),
            None => Ok(()),
        }
    }
}

impl Mechanics for MuJoCo {
    fn time_s(&self) -> f64 {
        self.data.time()
    }

    fn positions(&self) -> &[f64] {
        self.data.qpos()
    }

    fn rates(&self) -> &[f64] {
        self.data.qvel()
    }

    fn put(&mut self, first: usize, positions: &[f64], rates: &[f64]) {
        self.data.qpos_mut()[first..first + positions.len()].copy_from_slice(positions);
        self.data.qvel_mut()[first..first + rates.len()].copy_from_slice(rates);
    }

    fn drift(&mut self, dt_s: f64) {
        for i in 0..self.data.qpos().len() {
            // slides and hinges only: a coordinate each
            let way = dt_s * self.data.qvel()[i];
            self.data.qpos_mut()[i] += way;
        }
    }

    fn set_step_s(&mut self, step_s: f64) {
        self.data.model_opt_mut().timestep = step_s;
    }

    fn set_time_s(&mut self, time_s: f64) {
        self.data.set_time(time_s);
    }

    fn refresh(&mut self) {
        self.data.forward();
    }

    fn forces_mut(&mut self) -> &mut [f64] {
        self.data.qfrc_applied_mut()
    }

    fn set_damping(&mut self, first: usize, damping: &[f64]) {
        #[expect(unsafe_code, reason = "mujoco-rs lets nothing but the options change safely")]
        // SAFETY: numbers change, and the model stays the same one with the same sizes.
        let model = unsafe { self.data.model_mut() };
        model.dof_damping_mut()[first..first + damping.len()].copy_from_slice(damping);
    }

    fn set_flange_wrench_world(&mut self, wrench: &[f64; 6]) {
        if let Some(body) = self.flange_body {
            self.data.xfrc_applied_mut()[body] = *wrench;
        }
    }

    fn step(&mut self) -> Result<(), SimError> {
        self.data.step();
        self.check()
    }

    fn bias(&self) -> &[f64] {
        self.data.qfrc_bias()
    }

    fn mass_matrix(&mut self) -> &[f64] {
        if self.data.full_m(&mut self.mass).is_err() {
            self.mass.fill(f64::NAN);
        }
        &self.mass
    }

    fn flange_pose(&self) -> Option<FlangePose> {
        let body = self.flange_body?;
        let (position_world, [xx, xy, xz, yx, yy, yz, zx, zy, zz]) =
            (*self.data.xpos().get(body)?, *self.data.xmat().get(body)?);
        Some(FlangePose { position_world, axes_world: [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] })
    }

    fn set_load(&mut self, load: &LinkInertial) -> Result<(), SimError> {
        let Some(body) = self.load_body else { return Ok(()) };
        let [xx, .., yy, _, zz] = load.inertia_com;
        #[expect(unsafe_code, reason = "as for the damping")]
        // SAFETY: numbers change, and the model stays the same one with the same sizes.
        let model = unsafe { self.data.model_mut() };
        model.body_mass_mut()[body] = load.mass_kg;
        model.body_inertia_mut()[body] = [xx, yy, zz];
        model.body_ipos_mut()[body] = load.com_m;
        Ok(())
    }

    fn touched_n(&self) -> &[f64] {
        &self.data.sensordata()[..self.touch_sensors]
    }

    fn contacts(&self) -> usize {
        usize::try_from(self.data.ncon()).unwrap_or(0)
    }

    fn size(&self) -> ModelSize {
        let count = |n: i64| usize::try_from(n).unwrap_or(0);
        let model = self.data.model().ffi();
        ModelSize {
            dofs: count(model.nv),
            bodies: count(model.nbody),
            geoms: count(model.ngeom),
            sensors: count(model.nsensor),
            model_bytes: count(model.nbuffer),
            data_bytes: count(self.data.nbuffer()) + count(self.data.narena()),
            arena_bytes: count(self.data.narena()),
            arena_used_bytes: count(self.data.maxuse_arena()) + count(self.data.maxuse_stack()),
        }
    }
}
