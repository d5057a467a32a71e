//! Truths about a simulated robot that its controller does not know. What a controller believes stays in [`crate::robot`]: a
//! value here changes the plant alone.

use crate::robot::{AnyArm, BaseTable, FoamKind, LinkInertial};
use crate::table::{Field, FieldValue, ParameterKind, ParameterSpec, Size, Typed};

crate::parameter_table! {
    /// Delays and errors of a simulated base.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TrueBase in "simulation.true.base" {
        /// Delay of an order on its way to the servo.
        order_delay_ms: f64 = 0.0 => [.range(0.0, 1000.0).units(&["ms"]).lab("true.base.order_delay_ms")];
        /// Largest deviation from that delay, drawn for each order; orders arrive in sequence, and none before it is sent.
        order_jitter_ms: f64 = 0.0 => [.range(0.0, 1000.0).units(&["ms"]).lab("true.base.order_jitter_ms")];
        /// Time between two orders on that way; 0 sends one in every control period.
        order_period_ms: f64 = 0.0 => [.range(0.0, 1000.0).units(&["ms"]).lab("true.base.order_period_ms")];
        /// Time constant of the servo; 0 is that of robot.base.
        servo_ms: f64 = 0.0 => [.range(0.0, 1e4).units(&["ms"]).lab("true.base.servo_ms")];
        /// Acceleration along each axis; 0 is that of robot.base, and the yaw acceleration keeps its ratio to it.
        acceleration_m_s2: f64 = 0.0 => [.range(0.0, 1e4).units(&["m/s²"]).lab("true.base.acceleration")];
        /// Deceleration along each axis; 0 is the true acceleration, and yaw keeps its ratio to it.
        deceleration_m_s2: f64 = 0.0 => [.range(0.0, 1e4).units(&["m/s²"]).lab("true.base.deceleration")];
        /// Distance that odometry reports over the true one.
        odometry_scale: f64 = 1.0 => [.range(0.5, 2.0).lab("true.base.odometry_scale")];
        /// Age of odometry when it arrives, of which its stamp says nothing.
        odometry_delay_ms: f64 = 0.0 => [.range(0.0, 1000.0).units(&["ms"]).lab("true.base.odometry_delay_ms")];
        /// Standard deviation of a reported velocity, along each axis; of yaw the same number of rad/s.
        odometry_noise_m_s: f64 = 0.0 => [.range(0.0, 1.0).units(&["m/s"]).lab("true.base.odometry_noise")];
        /// Rate of odometry; 0 reports in every control period.
        odometry_rate_hz: f64 = 0.0 => [.range(0.0, 1e4).units(&["Hz"]).lab("true.base.odometry_rate_hz")];
    }
}

crate::parameter_table! {
    /// Errors of a simulated arm: its masses, its joints, and a tool that nobody told the controller about.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TrueArm in "simulation.true.arm" {
        /// Mass and inertia of every link over those of its table.
        mass_scale: f64 = 1.0 => [.range(0.5, 2.0).lab("true.arm.mass_scale")];
        /// Coulomb friction of every joint; below 0.01 rad/s it falls with the joint's speed, to 0 at rest.
        joint_friction_nm: f64 = 0.0 => [.range(0.0, 20.0).units(&["N·m"]).lab("true.arm.joint_friction")];
        /// Standard deviation of the torque that acts on a joint from the one that it reports, drawn for every control period.
        torque_noise_nm: f64 = 0.0 => [.range(0.0, 10.0).units(&["N·m"]).lab("true.arm.torque_noise")];
        /// Mass of a tool on the flange, beside what the configuration says; 0 is no tool.
        tool_mass_kg: f64 = 0.0 => [.range(0.0, 20.0).units(&["kg"]).lab("true.arm.tool_mass")];
        /// Its centre of mass in the flange's axes; it is a point mass.
        tool_com_m: [f64; 3] = [0.0, 0.0, 0.0] => [.range(-1.0, 1.0).units(&["m"]).lab("true.arm.tool_com")];
    }
}

crate::parameter_table! {
    /// Errors of a simulated foam.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TrueFoam in "simulation.true.foam" {
        /// Stiffness over that of its kind: age and cold raise it.
        scale: f64 = 1.0 => [.range(1e-3, 1e5).lab("true.foam.scale")];
        /// Kind; "as-described" is that of robot.cover, and "hyperbolic" has its numbers.
        kind: TrueFoamKind = TrueFoamKind(None) => [.lab("true.foam.kind")];
        /// Share of its force that a held foam loses in addition to that of its kind: creep.
        creep: f64 = 0.0 => [.range(0.0, 0.9).lab("true.foam.creep")];
    }
}

crate::parameter_table! {
    /// Errors of a simulated sensor of the cover.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TrueSensor in "simulation.true.sensor" {
        /// Age of every reading beyond what its board takes, of which the controller is not told.
        extra_age_ms: f64 = 0.0 => [.range(0.0, 1000.0).units(&["ms"]).lab("true.sensor.extra_age_ms")];
    }
}

crate::parameter_table! {
    /// Errors of a simulated force-torque sensor at the flange.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TrueFlangeSensor in "simulation.true.flange_sensor" {
        /// Force that it reads without a load, its own axes.
        bias_n: [f64; 3] = [0.0, 0.0, 0.0] => [.range(-200.0, 200.0).units(&["N"]).lab("true.flange_sensor.bias_n")];
        /// Moment that it reads without a load, its own axes.
        bias_nm: [f64; 3] = [0.0, 0.0, 0.0]
            => [.range(-20.0, 20.0).units(&["N·m"]).lab("true.flange_sensor.bias_nm")];
        /// Standard deviation of each axis of the force, drawn for every control period. A sensor without noise would count as frozen.
        noise_n: f64 = 0.1 => [.range(1e-4, 50.0).units(&["N"]).lab("true.flange_sensor.noise_n")];
        /// Standard deviation of each axis of the moment, drawn for every control period.
        noise_nm: f64 = 0.005 => [.range(1e-5, 5.0).units(&["N·m"]).lab("true.flange_sensor.noise_nm")];
        /// Rate at which the bias of each axis of the force grows.
        drift_n_s: f64 = 0.0 => [.range(-10.0, 10.0).units(&["N/s"]).lab("true.flange_sensor.drift_n_s")];
        /// Rate at which the bias of each axis of the moment grows.
        drift_nm_s: f64 = 0.0 => [.range(-1.0, 1.0).units(&["N·m/s"]).lab("true.flange_sensor.drift_nm_s")];
        /// Age of a reading when it arrives, of which the controller is not told.
        delay_ms: f64 = 0.0 => [.range(0.0, 1000.0).units(&["ms"]).lab("true.flange_sensor.delay_ms")];
    }
}

crate::parameter_table! {
    /// A cube that a simulated gripper can grasp, lift, drop and lose. What a request says of it is a belief.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct TrueObject in "simulation.true.object" {
        /// Mass; 0 is no object.
        mass_kg: f64 = 0.0 => [.range(0.0, 20.0).units(&["kg"])];
        /// Length of its edges.
        size_m: f64 = 0.05 => [.range(0.005, 0.5).units(&["m"])];
        /// Coulomb friction between it and a finger.
        friction: f64 = 0.5 => [.range(0.0, 2.0)];
        /// Place of its centre in the world at the start, on a support of its own; 0, 0, 0 is between the fingers.
        position_world_m: [f64; 3] = [0.0, 0.0, 0.0] => [.range(-1e3, 1e3).units(&["m"])];
    }
}

/// Kind of a foam that may be another than the one described.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrueFoamKind(pub Option<FoamKind>);

/// Word for the foam that is described.
const AS_DESCRIBED: &str = "as-described";

impl Typed for TrueFoamKind {
    const KIND: ParameterKind =
        ParameterKind::Choice(&[AS_DESCRIBED, "pu-ld30", "cc", "pe5", "pe3", "hyperbolic"]);
    const SIZE: Size = Size::One;
}

impl Field for TrueFoamKind {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        match &self.0 {
            Some(kind) => kind.see(see),
            None => see(FieldValue::Text(AS_DESCRIBED)),
        }
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        if value == FieldValue::Text(AS_DESCRIBED) {
            self.0 = None;
            return true;
        }
        let mut kind = FoamKind::PuLd30;
        let taken = kind.take(value);
        if taken {
            self.0 = Some(kind);
        }
        taken
    }
}

/// Everything that a simulated robot hides from its controller: `[simulation.true]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// `[simulation.true.base]`
    pub base: TrueBase,
    /// `[simulation.true.arm]`
    pub arm: TrueArm,
    /// `[simulation.true.foam]`
    pub foam: TrueFoam,
    /// `[simulation.true.sensor]`
    pub sensor: TrueSensor,
    /// `[simulation.true.flange_sensor]`
    pub flange_sensor: TrueFlangeSensor,
    /// `[simulation.true.object]`
    pub object: TrueObject,
}

impl Truth {
    /// Hands every field with its row to `visit`.
    pub fn each(&mut self, visit: &mut dyn FnMut(&'static ParameterSpec, &mut dyn Field)) {
        self.base.each(visit);
        self.arm.each(visit);
        self.foam.each(visit);
        self.sensor.each(visit);
        self.flange_sensor.each(visit);
        self.object.each(visit);
    }
}

impl TrueBase {
    /// A base as described, which obeys and reports at once.
    pub const AS_DESCRIBED: Self = Self {
        order_delay_ms: 0.0,
        order_jitter_ms: 0.0,
        order_period_ms: 0.0,
        servo_ms: 0.0,
        acceleration_m_s2: 0.0,
        deceleration_m_s2: 0.0,
        odometry_scale: 1.0,
        odometry_delay_ms: 0.0,
        odometry_noise_m_s: 0.0,
        odometry_rate_hz: 0.0,
    };

    /// Returns the base as it is, where `described` is what its controller believes.
    #[must_use]
    pub fn applied(&self, described: &BaseTable) -> BaseTable {
        let mut base = *described;
        if self.servo_ms > 0.0 {
            base.servo_time_constant_s = 1e-3 * self.servo_ms;
        }
        if self.acceleration_m_s2 > 0.0 {
            base.yaw_acceleration_max_rad_s2 *= self.acceleration_m_s2 / base.acceleration_max_m_s2;
            base.acceleration_max_m_s2 = self.acceleration_m_s2;
        }
        base
    }
}

impl TrueObject {
    /// No object.
    pub const NONE: Self = Self { mass_kg: 0.0, size_m: 0.05, friction: 0.5, position_world_m: [0.0; 3] };

    /// Inertia of the cube with its centre at `com_m` of some axes; a cube has the same about all of them.
    pub const fn at(&self, com_m: [f64; 3]) -> LinkInertial {
        let about_any = self.mass_kg * self.size_m * self.size_m / 6.0;
        LinkInertial {
            mass_kg: self.mass_kg,
            com_m,
            inertia_com: [about_any, 0.0, 0.0, about_any, 0.0, about_any],
        }
    }
}

impl TrueArm {
    /// An arm as described: no friction, no noise, no tool.
    pub const AS_DESCRIBED: Self = Self {
        mass_scale: 1.0,
        joint_friction_nm: 0.0,
        torque_noise_nm: 0.0,
        tool_mass_kg: 0.0,
        tool_com_m: [0.0; 3],
    };

    /// Returns the arm as it is, where `described` is what its controller believes.
    #[must_use]
    pub fn applied(&self, described: &AnyArm) -> AnyArm {
        let mut arm = *described;
        let scale = |link: &mut LinkInertial| {
            link.mass_kg *= self.mass_scale;
            link.inertia_com = link.inertia_com.map(|inertia| self.mass_scale * inertia);
        };
        scale(&mut arm.table.link0);
        arm.table.links.iter_mut().for_each(scale);
        arm
    }

    /// Inertia of the tool that the controller does not know, in the flange's axes.
    pub const fn tool(&self) -> LinkInertial {
        LinkInertial { mass_kg: self.tool_mass_kg, com_m: self.tool_com_m, inertia_com: [0.0; 6] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{PANDA, SUMMIT_XL};

    #[test]
    fn arm_as_described_is_default_and_changes_nothing() {
        assert_eq!(TrueArm::default(), TrueArm::AS_DESCRIBED);
        let panda = AnyArm::of(&PANDA);
        assert_eq!(TrueArm::AS_DESCRIBED.applied(&panda), panda);
    }

    #[test]
    fn heavier_arm_scales_every_link_and_moves_no_centre() {
        let panda = AnyArm::of(&PANDA);
        let heavy = TrueArm { mass_scale: 1.25, ..TrueArm::AS_DESCRIBED }.applied(&panda).table;
        assert_eq!(heavy.link0.mass_kg.to_bits(), (1.25 * panda.table.link0.mass_kg).to_bits());
        for (heavy, described) in heavy.links.iter().zip(panda.table.links) {
            let expected = LinkInertial {
                mass_kg: 1.25 * described.mass_kg,
                com_m: described.com_m,
                inertia_com: described.inertia_com.map(|inertia| 1.25 * inertia),
            };
            assert_eq!(*heavy, expected);
        }
    }

    #[test]
    fn base_as_described_is_default_and_changes_nothing() {
        assert_eq!(TrueBase::default(), TrueBase::AS_DESCRIBED);
        assert_eq!(TrueBase::AS_DESCRIBED.applied(&SUMMIT_XL), SUMMIT_XL);
    }

    #[test]
    fn foam_is_as_described_or_of_a_kind() {
        let said = |kind: TrueFoamKind| {
            let mut said = heapless::String::<16>::new();
            kind.see(&mut |value| {
                if let FieldValue::Text(word) = value {
                    said.push_str(word).unwrap();
                }
            });
            said
        };
        let mut kind = TrueFoamKind::default();
        assert_eq!(said(kind), AS_DESCRIBED);
        assert!(kind.take(FieldValue::Text("pe5")));
        assert_eq!((kind.0, said(kind).as_str()), (Some(FoamKind::Pe5), "pe5"));
        assert!(!kind.take(FieldValue::Text("rubber")) && kind.0 == Some(FoamKind::Pe5));
        assert!(kind.take(FieldValue::Text(AS_DESCRIBED)) && kind.0.is_none());
        let ParameterKind::Choice(words) = TrueFoamKind::KIND else { panic!("a choice") };
        assert!(words.iter().all(|word| kind.take(FieldValue::Text(word)) && said(kind) == *word));
    }

    #[test]
    fn true_acceleration_keeps_ratio_of_yaw() {
        let truth = TrueBase { servo_ms: 50.0, acceleration_m_s2: 1.5, ..TrueBase::AS_DESCRIBED };
        let base = truth.applied(&SUMMIT_XL);
        let expected = BaseTable {
            servo_time_constant_s: 0.05,
            acceleration_max_m_s2: 1.5,
            yaw_acceleration_max_rad_s2: 0.5 * SUMMIT_XL.yaw_acceleration_max_rad_s2,
            ..SUMMIT_XL
        };
        assert_eq!(base, expected);
    }
}
