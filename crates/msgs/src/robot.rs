//! Robot tables: plain constant data. `wbc` and `sim` each compute their own kinematics from them, and a test
//! compares the two.
//!
//! Sources: Panda kinematics from `franka_description`, Panda inertials from Gaz et al., RA-L 2019 (as published in
//! `franka_ros`), limits from `libfranka`'s documentation. Base, cover and other arms: see each table.
//!
//! ```
//! use moca_msgs::robot::{AnyArm, PANDA, PAPER_COVER, UR10E};
//!
//! assert_eq!((PANDA.joints(), PAPER_COVER.len()), (7, 11));
//! let any = AnyArm::of(&UR10E); // the number of joints is known only at run time
//! assert_eq!(any.table::<6>(), Some(UR10E));
//! assert_eq!(any.table::<7>(), None);
//! ```

use crate::sample::MAX_JOINTS;
use core::f64::consts::{FRAC_PI_2, PI};

/// Inertia of one rigid link in its own link frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LinkInertial {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the link frame, m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass, link axes: xx, xy, xz, yy, yz, zz, kg·m².
    pub inertia_com: [f64; 6],
}

impl LinkInertial {
    /// Point mass of `mass_kg` at `com_m`, m.
    pub const fn point(mass_kg: f64, com_m: [f64; 3]) -> Self {
        Self { mass_kg, com_m, inertia_com: [0.0; 6] }
    }

    /// Returns both bodies as one, by the parallel-axis theorem; a body without mass adds nothing.
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        if other.mass_kg <= 0.0 {
            return *self;
        }
        if self.mass_kg <= 0.0 {
            return *other;
        }
        let mass_kg = self.mass_kg + other.mass_kg;
        let com_m = core::array::from_fn(|i| {
            (self.mass_kg * self.com_m[i] + other.mass_kg * other.com_m[i]) / mass_kg
        });
        let mut inertia_com = [0.0; 6];
        for body in [self, other] {
            let [x, y, z] = core::array::from_fn(|i| body.com_m[i] - com_m[i]);
            let away = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y];
            for (i, sum) in inertia_com.iter_mut().enumerate() {
                *sum += body.inertia_com[i] + body.mass_kg * away[i];
            }
        }
        Self { mass_kg, com_m, inertia_com }
    }
}

/// A capsule around a part of a link: every point within a radius of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkCapsule {
    /// Link that carries it; 0 is the one that stands on the base.
    pub link: usize,
    /// Both ends of the segment in the link's frame, m; equal for a sphere.
    pub ends_m: [[f64; 3]; 2],
    /// Radius, m.
    pub radius_m: f64,
}

/// A serial arm of `N` revolute joints, each turning about the z axis of its own link frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(
        serialize = "[f64; N]: serde::Serialize, [[f64; 6]; N]: serde::Serialize, [LinkInertial; N]: serde::Serialize",
        deserialize = "[f64; N]: serde::Deserialize<'de>, [[f64; 6]; N]: serde::Deserialize<'de>, \
                       [LinkInertial; N]: serde::Deserialize<'de>"
    ))
)]
pub struct ArmTable<const N: usize> {
    /// Joint frame in its parent link frame: x, y, z m; roll, pitch, yaw rad (fixed axes, R = Rz·Ry·Rx).
    pub joint_origin: [[f64; 6]; N],
    /// Flange in the last link frame: x, y, z m; roll, pitch, yaw rad.
    pub flange_origin: [f64; 6],
    /// Inertia of link i + 1, the one that joint i moves.
    pub links: [LinkInertial; N],
    /// Inertia of link 0, which stands on the base.
    pub link0: LinkInertial,
    /// Lower joint limits, rad.
    pub q_min_rad: [f64; N],
    /// Upper joint limits, rad.
    pub q_max_rad: [f64; N],
    /// Joint speed limits, rad/s.
    pub dq_max_rad_s: [f64; N],
    /// Reduction of the joint speeds before the ends of their ranges; `None` where the limits are constant.
    pub speed_envelope: Option<SpeedEnvelope<N>>,
    /// Joint torque limits, N·m.
    pub torque_max_nm: [f64; N],
    /// Posture in which the arm starts and to which the null space returns, rad.
    pub home_rad: [f64; N],
    /// Null-space posture stiffness that suits the arm's torques, N·m/rad. eq. (11)
    pub posture_stiffness_nm_rad: [f64; N],
    /// Null-space posture damping that goes with it, N·m·s/rad. eq. (11)
    pub posture_damping_nm_s_rad: [f64; N],
}

/// Joint speed limits that fall towards the ends of the ranges, so that the arm's brakes can stop it there:
/// |q̇| ≤ min(dq_max, max(0, √(2·a·d) − o)) at a distance d from the end that the joint moves to.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(
        serialize = "[f64; N]: serde::Serialize",
        deserialize = "[f64; N]: serde::Deserialize<'de>"
    ))
)]
pub struct SpeedEnvelope<const N: usize> {
    /// o, rad/s.
    pub offset_rad_s: [f64; N],
    /// a, rad/s².
    pub deceleration_rad_s2: [f64; N],
}

impl<const N: usize> ArmTable<N> {
    /// Number of joints.
    pub const fn joints(&self) -> usize {
        N
    }
}

crate::parameter_table! {
    /// Pose of the arm's base (A) in the mobile base's frame (B).
    #[derive(Clone, Copy, Debug, PartialEq)]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
    pub struct Mount in "robot.mount" {
        /// Position of the arm's base: origin of A in B.
        position_base_m: [f64; 3] = MOCA_MOUNT.position_base_m
            => [.range(-5.0, 5.0).units(&["m"]).lab("mount.position")];
        /// Its axes in B: roll, pitch, yaw (fixed axes, R = Rz·Ry·Rx).
        rpy_rad: [f64; 3] = MOCA_MOUNT.rpy_rad => [.range(-7.0, 7.0).units(&["rad"]).lab("mount.rpy")];
    }
}

/// An arm whose number of joints is known only at run time: the first `joints` entries of a table that has room for
/// [`MAX_JOINTS`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AnyArm {
    /// Entries beyond the last joint are zero.
    pub table: ArmTable<MAX_JOINTS>,
    /// Number of joints.
    pub joints: usize,
}

impl Default for AnyArm {
    fn default() -> Self {
        Self::NONE
    }
}

impl AnyArm {
    /// No joints at all.
    pub const NONE: Self = Self::of(&NO_ARM);

    /// Any table of up to [`MAX_JOINTS`] joints.
    pub const fn of<const N: usize>(arm: &ArmTable<N>) -> Self {
        const { assert!(N <= MAX_JOINTS, "more joints than a sample can carry") };
        Self { table: resized_arm(arm), joints: N }
    }

    /// The table for a controller of `N` joints; `None` if the arm has another number.
    pub fn table<const N: usize>(&self) -> Option<ArmTable<N>> {
        (self.joints == N).then(|| resized_arm(&self.table))
    }
}

/// No joints at all.
pub(crate) const NO_ARM: ArmTable<0> = ArmTable {
    joint_origin: [],
    flange_origin: [0.0; 6],
    links: [],
    link0: Payload::NONE.inertial,
    q_min_rad: [],
    q_max_rad: [],
    dq_max_rad_s: [],
    speed_envelope: None,
    torque_max_nm: [],
    home_rad: [],
    posture_stiffness_nm_rad: [],
    posture_damping_nm_s_rad: [],
};

pub(crate) const fn resized_arm<const N: usize, const M: usize>(arm: &ArmTable<N>) -> ArmTable<M> {
    let mut sized = ArmTable {
        joint_origin: [[0.0; 6]; M],
        flange_origin: arm.flange_origin,
        links: [Payload::NONE.inertial; M],
        link0: arm.link0,
        q_min_rad: resized(&arm.q_min_rad),
        q_max_rad: resized(&arm.q_max_rad),
        dq_max_rad_s: resized(&arm.dq_max_rad_s),
        speed_envelope: match &arm.speed_envelope {
            Some(envelope) => Some(SpeedEnvelope {
                offset_rad_s: resized(&envelope.offset_rad_s),
                deceleration_rad_s2: resized(&envelope.deceleration_rad_s2),
            }),
            None => None,
        },
        torque_max_nm: resized(&arm.torque_max_nm),
        home_rad: resized(&arm.home_rad),
        posture_stiffness_nm_rad: resized(&arm.posture_stiffness_nm_rad),
        posture_damping_nm_s_rad: resized(&arm.posture_damping_nm_s_rad),
    };
    let mut i = 0;
    while i < N && i < M {
        sized.joint_origin[i] = arm.joint_origin[i];
        sized.links[i] = arm.links[i];
        i += 1;
    }
    sized
}

/// Copies the values into an array of another length: cut or filled with zeros.
pub const fn resized<const N: usize, const M: usize>(values: &[f64; N]) -> [f64; M] {
    let mut sized = [0.0; M];
    let mut i = 0;
    while i < N && i < M {
        sized[i] = values[i];
        i += 1;
    }
    sized
}

/// A tool fixed to the flange: its inertia, and the tool frame that the controllers hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Payload {
    /// Inertia in flange axes; a mass of 0 is no payload.
    pub inertial: LinkInertial,
    /// Tool frame in the flange frame: x, y, z m; roll, pitch, yaw rad.
    pub tool_origin: [f64; 6],
}

impl Payload {
    /// Bare flange: no mass, tool frame = flange frame.
    pub const NONE: Self = Self { inertial: LinkInertial::point(0.0, [0.0; 3]), tool_origin: [0.0; 6] };

    /// Returns it with another body on the flange, in the flange's axes; the tool frame stays.
    #[must_use]
    pub fn with(&self, body: &LinkInertial) -> Self {
        Self { inertial: self.inertial.with(body), ..*self }
    }
}

crate::parameter_table! {
    /// An omnidirectional, velocity-controlled mobile base.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct BaseTable in "robot.base" {
        /// Drive of the base; the laws need one that can drive sideways.
        drive: Drive = SUMMIT_XL.drive;
        /// Length (x), width (y), height (z).
        size_m: [f64; 3] = SUMMIT_XL.size_m => [.range(0.1, 10.0).units(&["m"])];
        /// Mass, the cover's included.
        mass_kg: f64 = SUMMIT_XL.mass_kg => [.range(1.0, 1e5).units(&["kg"])];
        /// Centre of mass in B.
        com_m: [f64; 3] = SUMMIT_XL.com_m => [.range(-10.0, 10.0).units(&["m"])];
        /// Inertia about the centre of mass: xx, yy, zz.
        inertia_com_diagonal: [f64; 3] = SUMMIT_XL.inertia_com_diagonal
            => [.range(1e-3, 1e6).units(&["kg·m²"])];
        /// Time constant of the velocity servo (first order).
        servo_time_constant_s: f64 = SUMMIT_XL.servo_time_constant_s => [.range(1e-4, 10.0).units(&["s"])];
        /// Largest linear acceleration that the servo reaches along each axis.
        acceleration_max_m_s2: f64 = SUMMIT_XL.acceleration_max_m_s2 => [.range(1e-3, 1e4).units(&["m/s²"])];
        /// Largest yaw acceleration that the servo reaches.
        yaw_acceleration_max_rad_s2: f64 = SUMMIT_XL.yaw_acceleration_max_rad_s2
            => [.range(1e-3, 1e4).units(&["rad/s²"])];
        /// The base stops by itself when it has heard no command for this long.
        command_timeout_s: f64 = SUMMIT_XL.command_timeout_s => [.range(0.01, 10.0).units(&["s"])];
    }
}

/// Drive of a base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drive {
    /// In every direction of the plane at once: mecanum or omni wheels, or steered ones.
    #[default]
    Holonomic,
    /// Forwards and about its middle only: known so that it can be refused with the reason.
    Differential,
}

crate::choice!(Drive { Holonomic: "holonomic", Differential: "differential" });

/// Foam under the plates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FoamKind {
    /// PU LD30, 15 mm.
    PuLd30,
    /// CC foam.
    Cc,
    /// PE LD45, 5 mm.
    Pe5,
    /// PE LD45, 3 mm.
    Pe3,
    /// F = k_0 d/(1 - d/h).
    Hyperbolic,
}

crate::choice!(FoamKind { PuLd30: "pu-ld30", Cc: "cc", Pe5: "pe5", Pe3: "pe3", Hyperbolic: "hyperbolic" });

/// Place of one taxel on the cover, and direction of a press on it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TaxelPlacement {
    /// Centre in B, m (x, y).
    pub position_base_m: [f64; 2],
    /// Direction of the sensor's x axis, which points inwards, in B, rad. A press pushes the robot this way.
    pub inward_angle_base_rad: f64,
}

/// Franka Emika Panda.
pub const PANDA: ArmTable<7> = ArmTable {
    joint_origin: [
        [0.0, 0.0, 0.333, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, -FRAC_PI_2, 0.0, 0.0],
        [0.0, -0.316, 0.0, FRAC_PI_2, 0.0, 0.0],
        [0.0825, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0],
        [-0.0825, 0.384, 0.0, -FRAC_PI_2, 0.0, 0.0],
        [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0],
        [0.088, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0],
    ],
    flange_origin: [0.0, 0.0, 0.107, 0.0, 0.0, 0.0],
    links: [
        link(
            4.970684,
            [0.003875, 0.002081, -0.04762],
            [0.70337, -0.000139, 0.006772, 0.70661, 0.019169, 0.009117],
        ),
        link(
            0.646926,
            [-0.003141, -0.02872, 0.003495],
            [0.007962, -0.003925, 0.010254, 0.02811, 0.000704, 0.025995],
        ),
        link(
            3.228604,
            [0.027518, 0.039252, -0.066502],
            [0.037242, -0.004761, -0.011396, 0.036155, -0.012805, 0.01083],
        ),
        link(
            3.587895,
            [-0.05317, 0.104419, 0.027454],
            [0.025853, 0.007796, -0.001332, 0.019552, 0.008641, 0.028323],
        ),
        link(
            1.225946,
            [-0.011953, 0.041065, -0.038437],
            [0.035549, -0.002117, -0.004037, 0.029474, 0.000229, 0.008627],
        ),
        link(
            1.666555,
            [0.060149, -0.014117, -0.010517],
            [0.001964, 0.000109, -0.001158, 0.004354, 0.000341, 0.005433],
        ),
        link(
            0.735522,
            [0.010517, -0.004252, 0.061597],
            [0.012516, -0.000428, -0.001196, 0.010027, -0.000741, 0.004815],
        ),
    ],
    link0: link(
        0.629769,
        [-0.041018, -0.00014, 0.049974],
        [0.00315, 8.2904e-7, 0.00015, 0.00388, 8.2299e-6, 0.004285],
    ),
    q_min_rad: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
    q_max_rad: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
    dq_max_rad_s: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
    speed_envelope: None,
    torque_max_nm: [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0],
    home_rad: [0.0, -PI / 4.0, 0.0, -3.0 * PI / 4.0, 0.0, PI / 2.0, PI / 4.0],
    // ASSUMED, tuned in simulation: the paper gives none
    posture_stiffness_nm_rad: [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0],
    posture_damping_nm_s_rad: [10.0, 10.0, 10.0, 10.0, 5.0, 3.5, 1.7],
};

/// Capsules of the Panda and of the Franka Research 3, which its maker compares (`franka_description`, `franka_arm.xacro`).
pub const PANDA_CAPSULES: [LinkCapsule; 10] = {
    // x and y of the flange's connector in the axes of link 7, which its maker's capsules are turned in by 45°
    const NEAR: f64 = 0.055 * core::f64::consts::FRAC_1_SQRT_2;
    const FAR: f64 = 0.065 * core::f64::consts::FRAC_1_SQRT_2;
    [
        capsule(0, [-0.09, 0.0, 0.06], [-0.06, 0.0, 0.06], 0.06),
        capsule(1, [0.0, 0.0, -0.333], [0.0, 0.0, -0.05], 0.06),
        capsule(2, [0.0, 0.0, -0.06], [0.0, 0.0, 0.06], 0.06),
        capsule(3, [0.0, 0.0, -0.22], [0.0, 0.0, -0.07], 0.06),
        capsule(4, [0.0, 0.0, -0.06], [0.0, 0.0, 0.06], 0.06),
        capsule(5, [0.0, 0.0, -0.31], [0.0, 0.0, -0.21], 0.06),
        capsule(5, [0.0, 0.08, -0.2], [0.0, 0.08, -0.06], 0.025),
        capsule(6, [0.0, 0.0, -0.07], [0.0, 0.0, 0.01], 0.05),
        capsule(7, [0.0, 0.0, -0.06], [0.0, 0.0, 0.08], 0.04),
        capsule(7, [NEAR, NEAR, 0.082], [FAR, FAR, 0.082], 0.03),
    ]
};

/// Franka Research 3: the Panda's kinematics with its own inertials and limits (`franka_description`, `robots/fr3`:
/// `inertials.yaml`, `joint_limits.yaml`).
pub const FR3: ArmTable<7> = ArmTable {
    links: [
        link(
            2.9274653454,
            [4.128e-07, -0.0181251324, -0.038603597],
            [
                0.023927316485108,
                1.3317903456e-05,
                -0.000114047749186,
                0.022482161327576,
                -0.001995032062824,
                0.00635009825853,
            ],
        ),
        link(
            2.9355370338,
            [0.0031828864, -0.0743221644, 0.0088146084],
            [
                0.041938946257609,
                0.000202573315211,
                0.00407778422718,
                0.025145148850147,
                -0.004225215800657,
                0.061702144728888,
            ],
        ),
        link(
            2.2449013699,
            [0.0407015686, -0.0048200565, -0.0289730823],
            [
                0.024101425472409,
                0.002404694559042,
                -0.002856269270114,
                0.019740532667082,
                -0.002104212683892,
                0.019044494482245,
            ],
        ),
        link(
            2.6155955791,
            [-0.0459100965, 0.063049296, -0.0085187868],
            [
                0.034529983219132,
                0.013225522659828,
                0.010151429984841,
                0.028881621933049,
                -0.00097628338707,
                0.041254711711466,
            ],
        ),
        link(
            2.3271207594,
            [-0.0016039605, 0.0292536262, -0.097296599],
            [
                0.051610278463663,
                -0.005715173387783,
                -0.003567316762587,
                0.047877297133715,
                0.010673985108536,
                0.016423625579357,
            ],
        ),
        link(
            1.8170376524,
            [0.0597131221, -0.0410294666, -0.0101692726],
            [
                0.005412333594383,
                0.006193456360286,
                0.001421928930612,
                0.01405832954551,
                -0.001314075374112,
                0.016080817924213,
            ],
        ),
        link(
            0.6271432862,
            [0.0045225817, 0.0086261921, -0.0161633251],
            [
                0.000210923891501,
                -2.4332991145e-05,
                4.5644803938e-05,
                0.000177185680024,
                8.7440702232e-05,
                5.9931905997e-05,
            ],
        ),
    ],
    link0: link(2.3966, [-0.0172, 0.0004, 0.0745], [0.0090, 0.0, 0.0020, 0.0115, 0.0, 0.0085]),
    q_min_rad: [-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508],
    q_max_rad: [2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508],
    dq_max_rad_s: [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26],
    speed_envelope: Some(SpeedEnvelope {
        offset_rad_s: [0.6520, 0.2500, 0.2005, 0.3542, 0.5738, 0.4885, 0.4592],
        deceleration_rad_s2: [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0],
    }),
    ..PANDA
};

/// Universal Robots UR10e; A is ROS `base_link`, the flange is `tool0` (`Universal_Robots_ROS2_Description`,
/// `config/ur10e`, its calibration's 1e-11 left out). Link 0 is a cylinder of 4 kg there.
pub const UR10E: ArmTable<6> = ArmTable {
    joint_origin: [
        [0.0, 0.0, 0.1807, 0.0, 0.0, PI],
        [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0],
        [-0.6127, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-0.57155, 0.0, 0.17415, 0.0, 0.0, 0.0],
        [0.0, -0.11985, 0.0, FRAC_PI_2, 0.0, 0.0],
        [0.0, 0.11655, 0.0, -FRAC_PI_2, 0.0, 0.0],
    ],
    flange_origin: [0.0; 6],
    links: [
        link(7.369, [0.021, -0.027, 0.0], [0.03408, 0.00425, 2e-05, 0.02156, -8e-05, 0.03529]),
        link(13.051, [-0.2327, 0.0, 0.158], [0.02814, 5e-05, -0.01561, 0.77068, 2e-05, 0.76943]),
        link(3.989, [-0.33155, 0.0, 0.068], [0.01014, 8e-05, 0.00916, 0.30928, 0.0, 0.30646]),
        link(2.1, [0.0, -0.018, 0.007], [0.00296, 0.0, -1e-05, 0.00258, 0.00024, 0.00222]),
        link(1.98, [0.0, 0.018, -0.007], [0.00296, 0.0, 1e-05, 0.00258, 0.00024, 0.00222]),
        link(0.615, [0.0, 0.0, -0.026], [0.0004, 0.0, 0.0, 0.00041, 0.0, 0.00034]),
    ],
    link0: link(4.0, [0.0; 3], [0.006106333333333333, 0.0, 0.0, 0.006106333333333333, 0.0, 0.01125]),
    q_min_rad: [-2.0 * PI, -2.0 * PI, -PI, -2.0 * PI, -2.0 * PI, -2.0 * PI],
    q_max_rad: [2.0 * PI, 2.0 * PI, PI, 2.0 * PI, 2.0 * PI, 2.0 * PI],
    speed_envelope: None,
    dq_max_rad_s: [2.0 * PI / 3.0, 2.0 * PI / 3.0, PI, PI, PI, PI],
    torque_max_nm: [330.0, 330.0, 150.0, 56.0, 56.0, 56.0],
    home_rad: [0.0, -2.0, 2.0, -FRAC_PI_2, -FRAC_PI_2, 0.0],
    // ASSUMED, as the Panda's
    posture_stiffness_nm_rad: [90.0; 6],
    posture_damping_nm_s_rad: [10.0; 6],
};

/// Arm mount of MOCA-S. ASSUMED: the paper does not give it.
pub const MOCA_MOUNT: Mount = Mount { position_base_m: [0.20, 0.0, 0.51], rpy_rad: [0.0; 3] };

/// Robotnik SUMMIT-XL with its cover. ASSUMED (public sources disagree): 105 kg box with its centre of mass 0.2 m up;
/// servo and limits as the collision experiment needs them.
pub const SUMMIT_XL: BaseTable = BaseTable {
    drive: Drive::Holonomic,
    size_m: [0.978, 0.776, 0.510],
    mass_kg: 105.0,
    com_m: [0.0, 0.0, 0.2],
    inertia_com_diagonal: [7.5449150000000005, 10.64511, 13.638275000000002],
    servo_time_constant_s: 0.015,
    acceleration_max_m_s2: 3.0,
    yaw_acceleration_max_rad_s2: 6.0,
    command_timeout_s: 0.1,
};

/// The paper's 11 taxels, T1 first (Fig. 2e): T1–T4 left side rear to front, T5–T7 front left to right, T8–T11 right
/// side **rear to front**. ASSUMED: only so are T4 + T8 and T1 + T11 opposite pure yaw torques (section IV-B).
pub const PAPER_COVER: [TaxelPlacement; 11] = [
    taxel(-0.36675, 0.388, -FRAC_PI_2),
    taxel(-0.12225, 0.388, -FRAC_PI_2),
    taxel(0.12225, 0.388, -FRAC_PI_2),
    taxel(0.36675, 0.388, -FRAC_PI_2),
    taxel(0.489, 0.776 / 3.0, PI),
    taxel(0.489, 0.0, PI),
    taxel(0.489, -0.776 / 3.0, PI),
    taxel(-0.36675, -0.388, FRAC_PI_2),
    taxel(-0.12225, -0.388, FRAC_PI_2),
    taxel(0.12225, -0.388, FRAC_PI_2),
    taxel(0.36675, -0.388, FRAC_PI_2),
];

const fn link(mass_kg: f64, com_m: [f64; 3], inertia_com: [f64; 6]) -> LinkInertial {
    LinkInertial { mass_kg, com_m, inertia_com }
}

const fn capsule(link: usize, from_m: [f64; 3], to_m: [f64; 3], radius_m: f64) -> LinkCapsule {
    LinkCapsule { link, ends_m: [from_m, to_m], radius_m }
}

const fn taxel(x: f64, y: f64, inward_angle_base_rad: f64) -> TaxelPlacement {
    TaxelPlacement { position_base_m: [x, y], inward_angle_base_rad }
}
