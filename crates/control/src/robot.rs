//! The robot at hand: its arm, base, cover, tool and load as data. Built-in tables are the defaults; a configuration
//! file, or a URDF for the arm, says what is different.

use moca_msgs::gripper::{FRANKA_HAND, GripperTable};
pub use moca_msgs::robot::FoamKind;
use moca_msgs::robot::{
    AnyArm, BaseTable, FR3, LinkCapsule, LinkInertial, Mount, PANDA, PANDA_CAPSULES, PAPER_COVER, Payload,
    TaxelPlacement, UR10E,
};
use moca_msgs::table::{Field, FieldValue, ParameterKind, Size, Typed};
use moca_msgs::{MAX_JOINTS, MAX_TAXELS, choice, parameter_table};
use moca_tactile::cover::{Electrode, MAX_BOARDS};
use moca_tactile::datastream::ELECTRODES;

/// Room for joints in states and commands; how many the arm has is in its table. What is beyond is zero.
pub const JOINTS: usize = MAX_JOINTS;
/// Room for taxels; how many the cover has is in its table. What is beyond feels nothing.
pub const TAXELS: usize = MAX_TAXELS;

parameter_table! {
    /// A robot, completely described.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Robot in "robot" {
        /// Name of this robot, shown by clients and written into logs.
        name: String = "moca".into();
        /// Which arm: one that is built in, or "own", which [arm] describes.
        arm: Arm = Arm::default() => [.lab("arm")];
        /// Name of the base.
        base_name: String = "SUMMIT-XL".into();
    }
    besides {
        /// Place of the arm on the base.
        mount: Mount = Mount::default();
        /// The base.
        base: BaseTable = BaseTable::default();
        /// The cover around it.
        cover: CoverTable = CoverTable::default();
        /// Tool fixed to the flange.
        tool: Tool = Tool::default();
        /// Load that the tool carries.
        load: Load = Load::default();
    }
}

parameter_table! {
    /// The cover: where its taxels sit, how they are wired, what is under them. T1 first.
    #[derive(Clone, Debug, PartialEq)]
    pub struct CoverTable in "robot.cover" {
        /// Centre of each taxel in B: forward.
        x_m: Vec<f64> = PAPER_COVER.map(|taxel| taxel.position_base_m[0]).into()
            => [.range(-5.0, 5.0).units(&["m"]).lab("taxels.x")];
        /// Centre of each taxel in B: left.
        y_m: Vec<f64> = PAPER_COVER.map(|taxel| taxel.position_base_m[1]).into()
            => [.range(-5.0, 5.0).units(&["m"]).lab("taxels.y")];
        /// Direction in which a press on each taxel pushes, angle from B's x axis.
        inward_rad: Vec<f64> = PAPER_COVER.map(|taxel| taxel.inward_angle_base_rad).into()
            => [.range(-7.0, 7.0).units(&["rad"]).lab("taxels.inward")];
        /// Board of each taxel in the order of board.port, 1 or 2; empty is all on the first.
        board: Vec<usize> = Vec::new() => [.range(1.0, 2.0)];
        /// Electrode of each taxel, 0 to 11 on its board, from 12 on further chips; empty counts up from 0 on each board.
        electrode: Vec<usize> = Vec::new() => [.range(0.0, 47.0)];
        /// Foam under the plates.
        foam: FoamKind = FoamKind::PuLd30;
        /// Stiffness k_0 of a hyperbolic foam, F = k_0 d/(1 - d/h).
        foam_stiffness_n_m: f64 = 2105.0 => [.range(10.0, 1e6).units(&["N/m"])];
        /// Thickness h of a hyperbolic foam.
        foam_thickness_m: f64 = 0.015 => [.range(1e-3, 0.1).units(&["m"])];
    }
}

parameter_table! {
    /// A tool fixed to the flange, and the frame that the laws hold; a mass of 0 is no tool.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Tool in "robot.tool" {
        /// Mass.
        mass_kg: f64 = 0.0 => [.range(0.0, 100.0).units(&["kg"])];
        /// Centre of mass in the flange's axes.
        com_m: [f64; 3] = [0.0; 3] => [.range(-2.0, 2.0).units(&["m"])];
        /// Inertia about the centre of mass, the flange's axes: xx, xy, xz, yy, yz, zz.
        inertia_com: [f64; 6] = [0.0; 6] => [.range(-100.0, 100.0).units(&["kg·m²"])];
        /// Tool frame in the flange's: x, y, z; roll, pitch, yaw.
        origin: [f64; 6] = [0.0; 6] => [.range(-7.0, 7.0).units(&["m", "m", "m", "rad", "rad", "rad"])];
        /// Capsule around the tool in the flange's axes: x, y, z of both ends.
        capsule_ends_m: [f64; 6] = [0.0; 6] => [.range(-2.0, 2.0).units(&["m"])];
        /// Radius of that capsule; 0 is none.
        capsule_radius_m: f64 = 0.0 => [.range(0.0, 1.0).units(&["m"])];
    }
}

parameter_table! {
    /// Load that the tool carries; a mass of 0 is no load.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Load in "robot.load" {
        /// Mass.
        mass_kg: f64 = 0.0 => [.range(0.0, 100.0).units(&["kg"])];
        /// Centre of mass in the flange's axes.
        com_m: [f64; 3] = [0.0; 3] => [.range(-2.0, 2.0).units(&["m"])];
        /// Inertia about the centre of mass, the flange's axes: xx, xy, xz, yy, yz, zz.
        inertia_com: [f64; 6] = [0.0; 6] => [.range(-100.0, 100.0).units(&["kg·m²"])];
    }
}

impl CoverTable {
    /// Returns the number of taxels.
    pub fn count(&self) -> usize {
        self.x_m.len()
    }

    /// Board and electrode of each taxel, T1 first.
    pub fn wiring(&self) -> Vec<Electrode> {
        let mut next = [0; MAX_BOARDS];
        let wire = |taxel: usize| {
            // Boards count from 1 in a configuration, as taxels do.
            let board = self.board.get(taxel).map_or(0, |number| number.saturating_sub(1));
            let in_order = next.get_mut(board).map_or(usize::MAX, |next| {
                *next += 1;
                *next - 1
            });
            let electrode = self.electrode.get(taxel).copied().unwrap_or(in_order);
            let small = |number| u8::try_from(number).unwrap_or(u8::MAX);
            Electrode { board: small(board), electrode: small(electrode) }
        };
        (0..self.count()).map(wire).collect()
    }

    /// Returns the mistake in the wiring of boards with one chip, as a virtual one has.
    pub fn beyond_one_chip(&self) -> Option<String> {
        let wiring = self.wiring();
        let taxel = wiring.iter().position(|wire| usize::from(wire.electrode) >= ELECTRODES)?;
        Some(format!(
            "robot.cover.electrode = {} of T{}: a virtual Touch Board has electrodes 0 to {}; robot.cover.board puts \
             taxels on a second one",
            wiring[taxel].electrode,
            taxel + 1,
            ELECTRODES - 1
        ))
    }

    /// Returns the places of the taxels, T1 first; as many as every list has.
    pub fn placements(&self) -> Vec<TaxelPlacement> {
        let places = self.x_m.iter().zip(&self.y_m).zip(&self.inward_rad);
        places
            .map(|((&x, &y), &inward_angle_base_rad)| TaxelPlacement {
                position_base_m: [x, y],
                inward_angle_base_rad,
            })
            .collect()
    }
}

impl Robot {
    /// Hands every field of the robot and of its parts to `visit`.
    pub fn each_part(
        &mut self,
        visit: &mut dyn FnMut(&'static moca_msgs::table::ParameterSpec, &mut dyn Field),
    ) {
        self.each(visit);
        self.mount.each(visit);
        self.base.each(visit);
        self.cover.each(visit);
        self.tool.each(visit);
        self.load.each(visit);
    }

    /// Tool and load as one body at the flange.
    pub fn payload(&self) -> Payload {
        let tool = LinkInertial {
            mass_kg: self.tool.mass_kg,
            com_m: self.tool.com_m,
            inertia_com: self.tool.inertia_com,
        };
        let load = LinkInertial {
            mass_kg: self.load.mass_kg,
            com_m: self.load.com_m,
            inertia_com: self.load.inertia_com,
        };
        Payload { inertial: tool.with(&load), tool_origin: self.tool.origin }
    }
}

/// An arm: its table and what it is called in a configuration file.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// A built-in name, or [`OWN_ARM`].
    pub source: String,
    /// Name shown to users.
    pub name: String,
    /// Kinematics, inertias, ranges, speeds, torques.
    pub table: AnyArm,
    /// Capsules around its links; empty where nobody gave any.
    pub capsules: Vec<LinkCapsule>,
}

/// `robot.arm` of an arm that `[arm]` describes.
pub const OWN_ARM: &str = "own";

/// A built-in arm: name in a configuration file, name shown to users, table, capsules.
type BuiltIn = (&'static str, &'static str, AnyArm, &'static [LinkCapsule]);

/// The built-in arms.
const BUILT_IN: [BuiltIn; 3] = [
    ("panda", "Franka Emika Panda", AnyArm::of(&PANDA), &PANDA_CAPSULES),
    ("fr3", "Franka Research 3", AnyArm::of(&FR3), &PANDA_CAPSULES),
    ("ur10e", "Universal Robots UR10e", AnyArm::of(&UR10E), &[]),
];

impl Arm {
    /// A built-in arm.
    pub fn built_in(name: &str) -> Option<Self> {
        BUILT_IN.iter().find(|(known, ..)| *known == name).map(Self::of)
    }

    fn of(&(source, shown, table, capsules): &BuiltIn) -> Self {
        Self { source: source.into(), name: shown.into(), table, capsules: capsules.into() }
    }

    /// The names of the built-in arms.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, ..)| *name)
    }
}

impl Default for Arm {
    fn default() -> Self {
        Self::of(&BUILT_IN[0])
    }
}

impl Typed for Arm {
    const KIND: ParameterKind = ParameterKind::Choice(&["panda", "fr3", "ur10e", OWN_ARM]);
    const SIZE: Size = Size::One;
}

impl Field for Arm {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        see(FieldValue::Text(&self.source));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        let FieldValue::Text(text) = value else { return false };
        if let Some(arm) = Self::built_in(text) {
            *self = arm;
        }
        self.source == text
    }
}

/// Which robot is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlantKind {
    /// MuJoCo.
    Simulated,
    /// A real one, behind drivers of its parts.
    Robot,
    /// No robot: the cover alone.
    None,
}

choice!(PlantKind { Simulated: "simulated", Robot: "robot", None: "none" });

/// Driver of a real arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmDriver {
    /// FCI: a Franka Research 3 or a Panda.
    Fci,
    /// None: the arm is simulated on a real base.
    Simulated,
    /// That of the program that runs the loop.
    Own,
}

choice!(ArmDriver { Fci: "fci", Simulated: "simulated", Own: "own" });

/// Source of a value about a real arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Believed {
    /// This program: its configuration, its own estimate.
    Ours,
    /// The arm itself.
    Arm,
}

choice!(Believed { Ours: "ours", Arm: "arm" });

/// Force-torque sensor between flange and tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlangeSensorKind {
    /// None: the momentum observer, or the arm itself, estimates the wrench.
    None,
    /// That of a simulated arm.
    Simulated,
    /// That of the program that runs the loop.
    Own,
}

choice!(FlangeSensorKind { None: "none", Simulated: "simulated", Own: "own" });

/// Driver of a real base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BaseDriver {
    /// ROS 2: velocity orders and odometry.
    Ros2,
    /// None: the base is simulated under a real arm.
    Simulated,
    /// That of the program that runs the loop.
    Own,
}

choice!(BaseDriver { Ros2: "ros2", Simulated: "simulated", Own: "own" });

/// Gripper on the flange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GripperKind {
    /// None.
    None,
    /// Two simulated fingers, with the ranges of a Franka Hand.
    Simulated,
    /// A Franka Hand over FCI, on the arm at `plant.arm.host`.
    Fci,
}

impl GripperKind {
    /// Ranges and geometry; `None` for none.
    pub const fn table(self) -> Option<GripperTable> {
        match self {
            Self::None => None,
            Self::Simulated | Self::Fci => Some(FRANKA_HAND),
        }
    }
}

choice!(GripperKind { None: "none", Simulated: "simulated", Fci: "fci" });

/// Which parts the robot has. What it lacks is neither simulated, started nor shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parts {
    /// Base with cover, and arm.
    Whole,
    /// The base with its cover: both laws follow the hand.
    Base,
    /// The arm on a stand, without a cover: both laws hold the flange where it is.
    Arm,
}

choice!(Parts { Whole: "whole", Base: "base", Arm: "arm" });

impl Parts {
    /// Returns true if there is a base, and with it a cover.
    pub const fn has_cover(self) -> bool {
        !matches!(self, Self::Arm)
    }

    /// Returns true if there is an arm.
    pub const fn has_arm(self) -> bool {
        !matches!(self, Self::Base)
    }
}
