//! Configuration: one documented TOML file. Each setting is one row of a table below, which gives its field, key, type,
//! unit, range, default and sentence; [`load`] reads files and reports every mistake at once, [`schema`] shows the rows.

mod bodies;
mod check;
pub mod contact_limits;
mod default_gains;
pub mod live;
pub mod load;
mod own_arm;
mod ports;
mod ros2;
pub mod schema;
mod self_collision;
pub mod stability;
pub mod urdf;

pub use own_arm::OwnArm;

pub use ports::{AUTO_PORT, NAMED_PORT, Ports};
pub use ros2::Ros2Config;

use crate::robot::{
    Arm, ArmDriver, BaseDriver, Believed, FlangeSensorKind, GripperKind, JOINTS, Parts, PlantKind, Robot,
    TAXELS,
};
use moca_msgs::request::PRESS_FORCE_MAX_N;
use moca_msgs::robot::AnyArm;
use moca_msgs::table::{Field, ParameterSpec};
use moca_msgs::{
    ContactReaction, Corrections, ImpedanceGains, Law, Limits, MAX_TAXELS, Parameters, Truth, choice,
    parameter_table,
};
use moca_tactile::calibration::CalibrationFile;
use moca_tactile::calibration::file::FileError;
use moca_tactile::cover::MaskPolicy;
use moca_tactile::model::ASSUMED_ERROR_FROM_N;
use moca_tactile::{CoverConfig, Firmware, TaxelModel};
use moca_telemetry::net::{Address, Token, address::SOCKET_NAME};
use moca_wbc::self_collision::DISTANCES_M;
use std::fmt;
use std::path::{Path, PathBuf};

/// Value of `telemetry.listen` with which the environment decides where that is.
const AUTO_LISTEN: &str = "auto";
/// Value of `flight_recorder.folder` with which the environment decides where that is.
pub const AUTO_FOLDER: &str = "auto";
/// Largest speed that an override of the speed limit may state, m/s.
pub const OVERRIDE_MAX_M_S: f64 = 10.0;
/// The documented default configuration.
pub const DEFAULT_TOML: &str = include_str!("../../config/mocad.toml");

#[expect(clippy::cast_precision_loss, reason = "a small count")]
const LAST_TAXEL: f64 = MAX_TAXELS as f64;

/// Everything that can be configured.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// `[robot]`: arm, base, cover, tool and load.
    pub robot: Robot,
    /// `[arm]`: lists that give an arm of one's own back; empty for one that is built in.
    pub own_arm: OwnArm,
    /// `[loop]`
    pub control_loop: LoopConfig,
    /// `[realtime]`
    pub realtime: RealtimeConfig,
    /// `[plant]`
    pub plant: PlantConfig,
    /// `[board]`
    pub board: BoardConfig,
    /// `[startup]`
    pub startup: StartupConfig,
    /// `[control]`
    pub control: ControlConfig,
    /// `[limits]`
    pub limits: Limits<JOINTS>,
    /// `[protection]`
    pub protection: ProtectionConfig,
    /// `[telemetry]`
    pub telemetry: TelemetryConfig,
    /// `[flight_recorder]`
    pub flight_recorder: FlightRecorderConfig,
    /// `[simulation]`
    pub simulation: SimulationConfig,
}

parameter_table! {
    /// `[control]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct ControlConfig in "control" {
        /// When the base goes back under the arm after the impedance law was pushed, and follows a wrench at the flange of less than
        /// 5 N and 2 N·m: "on-request" or, as published, "always".
        recentre: RecentrePolicy = RecentrePolicy::OnRequest => [.lab("recentre")];
    }
    besides {
        /// `[control.gains]`
        gains: ImpedanceGains<JOINTS> = ImpedanceGains::for_arm(&Arm::default().table.table);
        /// `[control.corrections]`: on where a user is better served; the paper's experiments switch them off.
        corrections: Corrections = Corrections::default();
        /// `[control.compensation]`
        compensation: CompensationConfig = CompensationConfig::default();
        /// `[control.self_collision]`
        self_collision: SelfCollisionConfig = SelfCollisionConfig::default();
    }
}

parameter_table! {
    /// `[control.self_collision]`: the arm keeps away from itself, the base and the floor. Off by default.
    #[derive(Clone, Debug, PartialEq)]
    pub struct SelfCollisionConfig in "control.self_collision" {
        /// Smallest distance between two parts of the robot, at least 0.005; 0 is off. An arm of your own needs capsules.
        distance_m: f64 = 0.0 => [.range(0.0, DISTANCES_M[1]).units(&["m"]).lab("self_collision.distance")];
    }
}

parameter_table! {
    /// `[control.compensation]`: loads that the arm's model does not know. Off by default: while a load is being learnt the
    /// flange is not passive.
    #[derive(Clone, Debug, PartialEq)]
    pub struct CompensationConfig in "control.compensation" {
        /// Time constant with which a load is learnt while the arm moves, at least 0.1; 0 compensates nothing.
        time_s: f64 = 0.0 => [.range(0.0, 10.0).units(&["s"]).lab("compensation.time")];
        /// Deviation of a joint's torque from its load that counts as a person's push: more than twice the friction of a joint. Known
        /// friction makes it smaller by as much.
        push_nm: f64 = 2.2 => [.range(0.5, 50.0).units(&["N·m"]).lab("compensation.push")];
        /// Largest change of a joint's load since the arm was held: what a steady push can wind up.
        bound_nm: f64 = 4.0 => [.range(0.0, 20.0).units(&["N·m"]).lab("compensation.bound")];
        /// Friction of each joint that is compensated at once, joint 1 first: at most what has been measured, or the arm hunts
        /// about its rest. Empty: none.
        friction_nm: Vec<f64> = Vec::new() => [.range(0.0, 20.0).units(&["N·m"]).lab("compensation.friction")];
    }
}

parameter_table! {
    /// `[loop]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct LoopConfig in "loop" {
        /// Control rate.
        rate_hz: u32 = 1000 => [.range(100.0, 10_000.0).units(&["Hz"]).lab("rate_hz")];
    }
}

parameter_table! {
    /// `[realtime]`: what to ask of the operating system.
    #[derive(Clone, Debug, PartialEq)]
    pub struct RealtimeConfig in "realtime" {
        /// SCHED_FIFO priority of the loop thread; 0 is normal scheduling.
        priority: u8 = 80 => [.range(0.0, 98.0)];
        /// Keep the process's pages in memory (mlockall).
        lock_memory: bool = true;
        /// Core the loop is pinned to; -1 for any.
        cpu: i32 = -1 => [.range(-1.0, 1023.0)];
        /// Keep the processors out of deep sleep.
        dma_latency: bool = true;
    }
}

parameter_table! {
    /// `[plant]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct PlantConfig in "plant" {
        /// Which robot is driven.
        kind: PlantKind = PlantKind::Simulated;
        /// Which parts the robot has.
        parts: Parts = Parts::Whole;
        /// Force-torque sensor between flange and tool: "simulated" is that of a simulated arm, "own" that of a program that runs the
        /// loop as a library. With one the laws do not use the momentum observer.
        flange_sensor: FlangeSensorKind = FlangeSensorKind::None;
        /// Place of that sensor in the flange's axes: x, y, z; roll, pitch, yaw.
        flange_sensor_origin: [f64; 6] = [0.0; 6]
            => [.range(-7.0, 7.0).units(&["m", "m", "m", "rad", "rad", "rad"])];
        /// Oldest wrench of that sensor that is controlled with.
        flange_sensor_deadline_s: f64 = 0.010 => [.range(0.001, 1.0).units(&["s"])];
        /// Largest force and moment along an axis that the sensor can read. ASSUMED: a usual 6-axis sensor for collaborative arms.
        flange_sensor_range: [f64; 2] = [300.0, 30.0] => [.range(0.1, 1e4).units(&["N", "N·m"])];
        /// Gripper on the flange. Its mass is robot.tool's.
        gripper: GripperKind = GripperKind::None;
    }
    besides {
        /// `[plant.arm]`
        arm: ArmPlantConfig = ArmPlantConfig::default();
        /// `[plant.base]`
        base: BasePlantConfig = BasePlantConfig::default();
    }
}

parameter_table! {
    /// `[plant.arm]`: a real arm.
    #[derive(Clone, Debug, PartialEq)]
    pub struct ArmPlantConfig in "plant.arm" {
        /// Driver of the arm: "simulated" is a simulated arm on a real base, "own" the driver of a program that runs the loop as a
        /// library.
        driver: ArmDriver = ArmDriver::Own;
        /// Address of its controller.
        host: String = "172.16.0.2".into();
        /// Longest wait for an order of the loop before the last one is repeated.
        answer_s: f64 = 0.0006 => [.range(0.0001, 0.0009).units(&["s"])];
        /// Joint torques above which it has a reflex.
        collision_torque_nm: [f64; 7] = [40.0, 40.0, 40.0, 40.0, 25.0, 25.0, 25.0] => [.range(5.0, 100.0).units(&["N·m"])];
        /// Forces and moments at the hand above which it has a reflex.
        collision_wrench: [f64; 6] = [60.0, 60.0, 60.0, 25.0, 25.0, 25.0]
            => [.range(5.0, 200.0).units(&["N", "N", "N", "N·m", "N·m", "N·m"])];
        /// Source of what it carries: "ours" is robot.tool and robot.load, "arm" the values entered in Desk, which must be set when
        /// this program starts.
        payload: Believed = Believed::Ours;
        /// Source of the wrench at its flange: "ours" is the momentum observer, which knows how the base accelerates, "arm" the arm's
        /// own estimate, which assumes a base at rest.
        external_wrench: Believed = Believed::Ours;
        /// Oldest state that is controlled with.
        deadline_s: f64 = 0.010 => [.range(0.002, 1.0).units(&["s"])];
    }
}

parameter_table! {
    /// `[plant.base]`: a real base.
    #[derive(Clone, Debug, PartialEq)]
    pub struct BasePlantConfig in "plant.base" {
        /// Driver of the base: "simulated" is a simulated base under a real arm.
        driver: BaseDriver = BaseDriver::Own;
        /// Oldest odometry that is driven with: five periods at 50 Hz.
        deadline_s: f64 = 0.100 => [.range(0.01, 1.0).units(&["s"])];
    }
    besides {
        /// `[plant.base.ros2]`
        ros2: Ros2Config = Ros2Config::default();
    }
}

parameter_table! {
    /// `[board]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct BoardConfig in "board" {
        /// "virtual", "avr" (the firmware itself, simulated), "auto" (the only board there is), "name:" and the name in its
        /// EEPROM, or a path; of two boards a list.
        port: Ports = Ports::default();
        /// Firmware of the virtual board; a real board is recognised by its lines.
        firmware: Firmware = Firmware::Moca;
        /// The name of the board, or of both together, in the calibration file.
        name: String = String::new();
        /// File that `mocad calibrate` wrote; empty for none.
        calibration: String = String::new();
        /// Conversion of counts to newtons without a calibration.
        model: AssumedModel = AssumedModel::PuLd30;
        /// Taxels out of use.
        masked: Vec<usize> = Vec::new() => [.range(1.0, LAST_TAXEL).units(&["(taxel number)"])];
        /// Meaning of a masked taxel.
        mask_policy: MaskPolicy = MaskPolicy::Stop;
        /// Port of a force gauge for calibrations; empty for none.
        gauge: String = String::new();
        /// Speed of the gauge's port.
        gauge_baud: u32 = 115_200 => [.range(300.0, 4e6).units(&["baud"])];
    }
}

parameter_table! {
    /// `[startup]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct StartupConfig in "startup" {
        /// Law that arming starts.
        law: Law = Law::Impedance;
        /// Measure the cover's zero when the first frames arrive.
        tare: bool = true;
        /// Arm by itself after that tare (simulation only).
        arm: bool = true;
    }
}

parameter_table! {
    /// `[protection]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct ProtectionConfig in "protection" {
        /// Force of an impact that limits the speed of the cover's fastest point.
        force_limit_n: f64 = 25.0 => [.range(1.0, 500.0).units(&["N"])];
        /// Largest force that the cover does not feel.
        threshold_force_n: f64 = 5.2 => [.range(0.0, 100.0).units(&["N"])];
        /// Stiffness of cover and body in series at the force limit.
        contact_stiffness_n_m: f64 = 7783.0 => [.range(100.0, 1e6).units(&["N/m"])];
        /// Way that cover and body yield from the threshold force to the force limit.
        contact_travel_m: f64 = 0.0031 => [.range(1e-4, 0.1).units(&["m"])];
        /// Forces of your own risk assessment: `moca-lab latency` prints the speed for each.
        assessed_forces_n: Vec<f64> = vec![25.0, 65.0, 130.0, 260.0] => [.range(6.0, 1000.0).units(&["N"])];
        /// Keeps every contact under the force limit from inside the law; how it understands the cover's readings.
        contact_barrier: BarrierReadings = BarrierReadings::Auto => [.lab("barrier")];
        /// Delay of an order on its way to the base's servo, as the contact barrier counts it in.
        order_delay_ms: f64 = 0.0 => [.range(0.0, 500.0).units(&["ms"])];
        /// Largest error of that delay and of the servo's time constant together: the barrier responds slowly enough for it.
        order_delay_error_ms: f64 = 0.0 => [.range(0.0, 500.0).units(&["ms"])];
        /// Speeds at which the base's stopping distance was measured, rising; empty for none.
        stopping_speed_m_s: Vec<f64> = Vec::new() => [.range(0.001, 3.0).units(&["m/s"])];
        /// Upper bound of the stopping distance at each of them, from the order to the rest.
        stopping_distance_m: Vec<f64> = Vec::new() => [.range(1e-5, 3.0).units(&["m"])];
        /// Date and number of the stops behind it; logged.
        stopping_measured: String = String::new();
        /// Stiffness of the foam that is credible, over the calibrated one; 0 is 1 for a calibration of the last year, else 1.5.
        foam_credible: f64 = 0.0 => [.range(0.0, 4.0)];
        /// Plates that one body may press at once, each by all of its depth.
        plates: u8 = 1 => [.range(1.0, 3.0)];
        /// Another speed limit, whatever the board's rate; 0 is no override.
        override_speed_limit_m_s: f64 = 0.0 => [.range(0.0, OVERRIDE_MAX_M_S).units(&["m/s"])];
        /// Why the limit is overridden; logged.
        override_statement: String = String::new();
        /// File of contact limits; empty for none.
        thresholds: String = String::new();
        /// Why contact limits hold on an uncalibrated cover; logged.
        uncalibrated_statement: String = String::new();
        /// Reaction to a crossed contact limit, until that contact ends.
        reaction: ContactReaction = ContactReaction::StopDirection;
        /// Speed limit of "slow".
        slow_m_s: f64 = 0.01 => [.range(0.0, 1.0).units(&["m/s"])];
        /// Speed of "retreat".
        retreat_m_s: f64 = 0.05 => [.range(0.001, 1.0).units(&["m/s"])];
        /// Longest way of a retreat.
        retreat_m: f64 = 0.10 => [.range(0.0, 1.0).units(&["m"])];
        /// Speed towards a side that no taxel covers; the limit of the covered ones holds there too.
        uncovered_m_s: f64 = 3.0 => [.range(0.0, 3.0).units(&["m/s"])];
        /// Longest way towards a side that no taxel covers, until nobody touches the robot and it has rested.
        uncovered_m: f64 = 0.10 => [.range(0.0, 100.0).units(&["m"])];
        /// Distance for motion that the contact barrier makes for a person who presses from the other side.
        uncovered_room_m: f64 = 1.0 => [.range(0.0, 100.0).units(&["m"])];
    }
}

parameter_table! {
    /// `[telemetry]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct TelemetryConfig in "telemetry" {
        /// Socket file or port for operators; empty for none.
        listen: String = AUTO_LISTEN.into();
        /// Permission bits of that socket file, octal.
        mode: String = AUTO_LISTEN.into();
        /// Socket file that shows the robot to everybody and takes no request but a stop; empty for none.
        watch: String = AUTO_LISTEN.into();
        /// File with the secret that admits to a port.
        token: String = AUTO_LISTEN.into();
        /// Address and port for programs of other machines, over TLS with certificates of `mocad access`; empty for none.
        tls: String = String::new();
    }
}

parameter_table! {
    /// `[flight_recorder]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct FlightRecorderConfig in "flight_recorder" {
        /// Folder for the last 10 s before a fault.
        folder: String = AUTO_FOLDER.into();
    }
}

parameter_table! {
    /// `[simulation]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct SimulationConfig in "simulation" {
        /// Seed of the sensor's noise.
        seed: u64 = 1 => [.lab("seed")];
        /// Error of a control period, over 25 N and 15 mm, for which physics steps are chosen; 0 takes one step of 1 ms.
        accuracy: f64 = 0.0 => [.range(0.0, 0.1).lab("accuracy")];
    }
    besides {
        /// `[simulation.hand]`
        hand: HandConfig = HandConfig::default();
        /// `[simulation.true]`
        truth: Truth = Truth::default();
    }
}

parameter_table! {
    /// `[simulation.hand]`
    #[derive(Clone, Debug, PartialEq)]
    pub struct HandConfig in "simulation.hand" {
        /// Taxels pressed in turn.
        taxels: Vec<usize> = vec![6, 2, 10] => [.range(1.0, LAST_TAXEL).units(&["(taxel number)"])];
        /// Force of a press.
        force_n: f64 = 20.0 => [.range(0.0, PRESS_FORCE_MAX_N).units(&["N"])];
        /// From one press to the next.
        every_s: f64 = 6.0 => [.range(1.0, 3600.0).units(&["s"])];
        /// Length of a press; at most every_s - 0.7 s.
        hold_s: f64 = 2.0 => [.range(0.1, 3599.3).units(&["s"])];
    }
}

impl HandConfig {
    /// Its taxels, as far as a cover of `count` has them; others in their place, spread over the cover.
    pub fn reachable(&self, count: usize) -> Vec<usize> {
        let there = |taxel: &usize| (1..=count).contains(taxel);
        if self.taxels.iter().all(there) {
            return self.taxels.clone();
        }
        let most = self.taxels.len().min(count);
        (0..most).map(|i| 1 + i * count / most).collect()
    }

    /// No scripted hand.
    pub fn none() -> Self {
        Self { taxels: Vec::new(), ..Self::default() }
    }
}

impl ProtectionConfig {
    /// Stiffness of the foam that is credible, over the calibrated one; a foam of which nothing is stated is as calibrated.
    pub fn foam_scale(&self) -> f64 {
        if self.foam_credible > 0.0 { self.foam_credible } else { 1.0 }
    }
}

/// Conversion of counts to newtons on an uncalibrated cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AssumedModel {
    /// The curve of simulated PU LD30.
    PuLd30,
    /// The paper's line: 100 N at 84 counts.
    Paper,
}

/// Cause for which the base goes back under the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecentrePolicy {
    /// A request; the posture stiffness alone never drives the base.
    OnRequest,
    /// The posture stiffness, as soon as nobody pushes harder.
    Always,
}

/// Use of the contact barrier, and the meaning of the cover's readings for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BarrierReadings {
    /// Those of a calibration where there is one, and no barrier without.
    Auto,
    /// There is none.
    Off,
    /// True forces on the foam of `robot.cover`, such as those of an ideal sensor.
    Foam,
    /// Forces that PU LD30 would need for the same plate gap: a cover that has not been calibrated.
    PuLd30,
}

choice!(BarrierReadings { Auto: "auto", Off: "off", Foam: "foam", PuLd30: "pu-ld30" });

choice!(RecentrePolicy { OnRequest: "on-request", Always: "always" });

choice!(AssumedModel { PuLd30: "pu-ld30", Paper: "paper" });

impl AssumedModel {
    const fn model(self) -> TaxelModel {
        match self {
            Self::PuLd30 => TaxelModel::PU_LD30,
            Self::Paper => TaxelModel::PAPER,
        }
    }
}

impl TelemetryConfig {
    /// Permission bits of the operators' socket file: as a service its group's, or else this user's alone.
    pub fn socket_mode(&self) -> Option<u32> {
        if self.mode == AUTO_LISTEN {
            return Some(if service_socket().is_some() { 0o660 } else { 0o600 });
        }
        let bits = u32::from_str_radix(&self.mode, 8).ok()?;
        (0o600..=0o777).contains(&bits).then_some(bits)
    }
}

/// systemd's RuntimeDirectory is where a service's socket belongs.
fn service_socket() -> Option<PathBuf> {
    let folders = std::env::var_os("RUNTIME_DIRECTORY")?;
    let folder = std::env::split_paths(&folders).next().filter(|folder| folder.is_absolute())?;
    Some(folder.join(SOCKET_NAME))
}

impl Default for Config {
    fn default() -> Self {
        Self::with_arm(Arm::default())
    }
}

impl Config {
    /// The defaults for a robot with this arm.
    pub fn with_arm(arm: Arm) -> Self {
        let table = &arm.table.table;
        Self {
            control: ControlConfig { gains: ImpedanceGains::for_arm(table), ..ControlConfig::default() },
            limits: Limits::for_arm(table),
            own_arm: OwnArm::of(&arm),
            robot: Robot { arm, ..Robot::default() },
            control_loop: LoopConfig::default(),
            realtime: RealtimeConfig::default(),
            plant: PlantConfig::default(),
            board: BoardConfig::default(),
            startup: StartupConfig::default(),
            protection: ProtectionConfig::default(),
            telemetry: TelemetryConfig::default(),
            flight_recorder: FlightRecorderConfig::default(),
            simulation: SimulationConfig::default(),
        }
    }

    /// Hands every setting with its row to `visit`: the controllers' first, so that their numbers are those of
    /// [`moca_msgs::params::CONTROLLER`].
    pub fn each(&mut self, visit: &mut dyn FnMut(&'static ParameterSpec, &mut dyn Field)) {
        self.control.gains.each(visit);
        self.control.corrections.each(visit);
        self.limits.each(visit);
        self.control.each(visit);
        self.control.compensation.each(visit);
        self.control.self_collision.each(visit);
        self.robot.each_part(visit);
        self.own_arm.each(visit);
        self.control_loop.each(visit);
        self.realtime.each(visit);
        self.plant.each(visit);
        self.plant.arm.each(visit);
        self.plant.base.each(visit);
        self.plant.base.ros2.each(visit);
        self.board.each(visit);
        self.startup.each(visit);
        self.protection.each(visit);
        self.telemetry.each(visit);
        self.flight_recorder.each(visit);
        self.simulation.each(visit);
        self.simulation.hand.each(visit);
        self.simulation.truth.each(visit);
    }

    /// Control period, ns.
    pub fn period_ns(&self) -> u64 {
        1_000_000_000 / u64::from(self.control_loop.rate_hz.max(1))
    }

    /// Returns the cover's settings: calibration, masks.
    ///
    /// # Errors
    /// A calibration file that cannot be read, is of another board, or does not name every taxel.
    pub fn cover(&self) -> Result<CoverConfig<TAXELS>, FileError> {
        let mut cover = CoverConfig {
            taxels: self.robot.cover.count(),
            mask_policy: self.board.mask_policy,
            models: [self.board.model.model(); TAXELS],
            force_max_n: self.limits.taxel_force_n,
            ..CoverConfig::default()
        };
        for (wire, taxel) in cover.wiring.iter_mut().zip(self.robot.cover.wiring()) {
            *wire = taxel;
        }
        for &taxel in &self.board.masked {
            if let Some(masked) = taxel.checked_sub(1).and_then(|i| cover.masked.get_mut(i)) {
                *masked = true;
            }
        }
        if !self.board.calibration.is_empty() {
            CalibrationFile::read(Path::new(&self.board.calibration))?.apply(&self.board.name, &mut cover)?;
        }
        Ok(cover)
    }

    /// Returns the accuracy of forces on an uncalibrated cover, in one sentence.
    pub fn uncalibrated(&self) -> Option<String> {
        let assumed = self.plant.parts.has_cover() && self.board.calibration.is_empty();
        let percent = 100.0 * self.board.model.model().assumed_error();
        assumed.then(|| {
            format!("uncalibrated: forces of {ASSUMED_ERROR_FROM_N} N and more may be {percent:.0} % off on PU LD30")
        })
    }

    /// Returns the address on which telemetry listens, if any; checked by [`Config::check`].
    pub fn telemetry_address(&self) -> Option<Address> {
        match self.telemetry.listen.as_str() {
            AUTO_LISTEN => Some(service_socket().map_or_else(Address::of_this_user, Address::Unix)),
            listen => listen.parse().ok(),
        }
    }

    /// The socket file that only shows, if there is one: beside an automatic address unless told otherwise.
    pub fn watch_socket(&self) -> Option<PathBuf> {
        match (self.telemetry.watch.as_str(), self.telemetry.listen.as_str()) {
            (AUTO_LISTEN, AUTO_LISTEN) => self.telemetry_address()?.watch_socket(),
            (AUTO_LISTEN, _) => None,
            (watch, _) => match watch.parse().ok()? {
                Address::Unix(path) => Some(path),
                Address::Tcp(_) | Address::Tls { .. } => None,
            },
        }
    }

    /// The file with the secret that admits to a port.
    pub fn token_path(&self) -> Option<PathBuf> {
        match self.telemetry.token.as_str() {
            AUTO_LISTEN => Token::default_path(),
            path => Some(path.into()),
        }
    }

    /// The arm's table.
    pub const fn arm(&self) -> &AnyArm {
        &self.robot.arm.table
    }

    /// The controllers' parameters.
    pub fn parameters(&self) -> Parameters<JOINTS> {
        Parameters {
            gains: self.control.gains,
            corrections: self.control.corrections,
            limits: Limits { period_s: 1.0 / f64::from(self.control_loop.rate_hz.max(1)), ..self.limits },
        }
    }
}

/// Every mistake of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigError {
    /// One line each.
    pub mistakes: Vec<String>,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.mistakes.join("\n"))
    }
}

impl std::error::Error for ConfigError {}
