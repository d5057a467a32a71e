//! Parameters of the controllers. Defaults are the gains that reproduce the paper's text; the paper gives none
//! (ASSUMED, tuned in simulation), so every one of them is configuration. Each is declared once, in the tables below
//! ([`crate::table`] says what a row is); [`CONTROLLER`] is all of their rows.
//!
//! ```
//! use moca_msgs::params::{CONTROLLER, ParameterValues, Parameters};
//!
//! let mut parameters = Parameters::PAPER;
//! let number = CONTROLLER.iter().position(|row| row.name == "control.gains.reactivity").ok_or("no such row")?;
//! let values = ParameterValues::new(&[2.0]).ok_or("too many")?;
//! parameters.set(number, &values).map_err(|_| "out of range")?;
//! assert_eq!(parameters.gains.reactivity, 2.0);
//! # Ok::<(), &str>(())
//! ```

use crate::Refusal;
use crate::parameter_table;
use crate::robot::{ArmTable, NO_ARM, PANDA, resized_arm};
use crate::table::FieldValue;

pub use crate::table::{ParameterError, ParameterKind, ParameterSpec, Size};

parameter_table! {
    /// Gains of the expanded controllers, eqs. (2), (9)–(11), (15)–(16).
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ImpedanceGains<const N: usize> in "control.gains", for_arm(arm) {
        /// Virtual mass of the base, M_v of eq. (2); at least 0.5 with null_space_damping.
        virtual_mass: [f64; 3] = [4.0, 4.0, 2.0]
            => [.range(0.01, 1000.0).units(&["kg", "kg", "kg·m²"]).live().lab("m_v")];
        /// Virtual damping of the base, D_v of eq. (2).
        virtual_damping: [f64; 3] = [80.0, 80.0, 60.0]
            => [.range(0.0, 1e5).units(&["N·s/m", "N·s/m", "N·m·s/rad"]).live().lab("d_v")];
        /// Cartesian stiffness of the flange, K_d of eq. (10).
        stiffness: [f64; 6] = [800.0, 800.0, 800.0, 40.0, 40.0, 40.0]
            => [.range(0.0, 1e5).units(&["N/m", "N/m", "N/m", "N·m/rad", "N·m/rad", "N·m/rad"]).live().lab("k_d")];
        /// Damping ratio of D_d = A√K + √K A with A = ζ Λ^½, eq. (10).
        damping_ratio: f64 = 0.9 => [.range(0.0, 5.0).live().lab("zeta")];
        /// Weight of the base in H, eq. (9).
        eta_base: f64 = 3.0 => [.range(1e-3, 1e3).live().lab("eta_b")];
        /// Weight of the arm in H, eq. (9).
        eta_arm: f64 = 1.0 => [.range(1e-3, 1e3).live().lab("eta_a")];
        /// Null-space posture stiffness, K_0 of eq. (11).
        posture_stiffness: [f64; N] = arm.posture_stiffness_nm_rad
            => [.per_joint().range(0.0, 1e4).units(&["N·m/rad"]).live().lab("k_0")];
        /// Null-space posture damping, D_0 of eq. (11).
        posture_damping: [f64; N] = arm.posture_damping_nm_s_rad
            => [.per_joint().range(0.0, 1e3).units(&["N·m·s/rad"]).live().lab("d_0")];
        /// Null-space posture of eq. (11), and of the simulated arm at its start.
        posture_rad: [f64; N] = arm.home_rad
            => [.per_joint().range(-7.0, 7.0).units(&["rad"]).live().lab("q_0")];
        /// Scale of τ_v,ext, the wrench on the base: the cover's, and in eq. (12) the flange's.
        reactivity: f64 = 1.0 => [.range(0.0, 10.0).live().lab("reactivity")];
    }
}

impl ImpedanceGains<{ PANDA.joints() }> {
    /// The gains that reproduce the paper's text on a Panda.
    pub const PAPER: Self = Self::for_arm(&PANDA);
}

parameter_table! {
    /// Corrections of what the literal law leaves out. The default is where a user is better served.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
    pub struct Corrections in "control.corrections" {
        /// Keep the base's virtual damping from dragging the flange: −D_v v_d of eq. (2) moves into τ_0.
        null_space_damping: bool = true => [.live().lab("null_space_damping")];
        /// Feed forward to the arm the inertial coupling M_AB q̈_B that eq. (3) ignores.
        base_coupling: bool = true => [.live().lab("base_coupling")];
        /// Let the base feel a force at the flange, J_Bᵀ F̂_ext in eq. (2) (needs a trusted flange wrench).
        flange_wrench_feedforward: bool = false => [.live().lab("flange_wrench_feedforward")];
    }
}

impl Corrections {
    /// The paper's law to the letter: all off.
    pub const LITERAL: Self =
        Self { null_space_damping: false, base_coupling: false, flange_wrench_feedforward: false };
}

parameter_table! {
    /// Limits on what a controller may give out: torques of the arm, SUMMIT-XL acceleration; speeds ASSUMED for use
    /// near people.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Limits<const N: usize> in "limits", for_arm(arm) {
        /// Largest joint torque.
        torque_nm: [f64; N] = arm.torque_max_nm
            => [.per_joint().range(0.0, 1e3).units(&["N·m"]).lab("limit.torque")];
        /// Largest rate of a joint torque (that of Franka's arms, libfranka).
        torque_rate_nm_s: f64 = 1000.0 => [.range(1.0, 1e5).units(&["N·m/s"]).lab("limit.torque_rate")];
        /// Largest base velocity along each axis of B.
        base_velocity: [f64; 3] = [0.5, 0.5, 0.8]
            => [.range(0.0, 3.0).units(&["m/s", "m/s", "rad/s"]).live().lab("limit.base_velocity")];
        /// Largest base acceleration along each axis of B.
        base_acceleration: [f64; 3] = [3.0, 3.0, 6.0]
            => [.range(0.01, 50.0).units(&["m/s²", "m/s²", "rad/s²"]).live().lab("limit.base_acceleration")];
        /// Largest force believed from one taxel.
        taxel_force_n: f64 = 200.0 => [.range(1.0, 1e4).units(&["N"]).live()];
        /// Speed of the flange in W beyond which the robot stops; above what base limits and reference speed add up to.
        flange_speed_m_s: f64 = 1.0 => [.range(0.01, 3.0).units(&["m/s"]).lab("limit.flange_speed")];
        /// Distance of the flange from where it is wanted beyond which the robot stops: beyond the 0.1 m that the law
        /// acts on it is no longer held.
        pose_error_m: f64 = 0.2 => [.range(0.001, 1.0).units(&["m"]).lab("limit.pose_error")];
        /// Angle of the flange to its wanted orientation beyond which the robot stops.
        pose_error_rad: f64 = 0.8 => [.range(0.01, 3.2).units(&["rad"]).lab("limit.angle_error")];
    }
    besides {
        /// Nominal control period, s: rate limits credit no more time than this, however late a step is. Configured as
        /// a rate.
        period_s: f64 = 1e-3;
    }
}

/// Everything a controller is configured with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters<const N: usize> {
    /// Gains.
    pub gains: ImpedanceGains<N>,
    /// Corrections of the literal law.
    pub corrections: Corrections,
    /// Limits.
    pub limits: Limits<N>,
}

impl<const N: usize> Parameters<N> {
    /// Literal law, with the gains and limits of `arm`: [`ImpedanceGains::for_arm`], [`Limits::for_arm`].
    pub const fn for_arm(arm: &ArmTable<N>) -> Self {
        Self {
            gains: ImpedanceGains::for_arm(arm),
            corrections: Corrections::LITERAL,
            limits: Limits::for_arm(arm),
        }
    }
}

impl Parameters<{ PANDA.joints() }> {
    /// The paper's experiments: literal law, gains that reproduce the text.
    pub const PAPER: Self = Self::for_arm(&PANDA);
}

impl<const N: usize> Parameters<N> {
    /// Returns the parameters for another number of joints: per-joint lists are cut or filled with zeros.
    pub fn resized<const M: usize>(&self) -> Parameters<M> {
        let mut sized = Parameters::for_arm(&resized_arm::<0, M>(&NO_ARM));
        for (number, row) in CONTROLLER.iter().enumerate() {
            if let Some(mut values) = self.get(number) {
                if row.size == Size::Joints {
                    values.len = u8::try_from(M).unwrap_or(0);
                }
                sized.put(number, values.as_slice());
            }
        }
        sized.limits.period_s = self.limits.period_s;
        sized
    }

    fn put(&mut self, number: usize, values: &[f64]) -> bool {
        let (mut taken, mut at) = (false, 0);
        self.each(&mut |_, field| {
            if at == number {
                taken = field.take(FieldValue::Numbers(values));
            }
            at += 1;
        });
        taken
    }
}

/// Most elements of one parameter.
pub const MAX_ELEMENTS: usize = crate::sample::MAX_JOINTS;

/// The elements of one parameter as numbers. The default has none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ParameterValues {
    len: u8,
    values: [f64; MAX_ELEMENTS],
}

impl ParameterValues {
    /// `None` for more than [`MAX_ELEMENTS`].
    pub fn new(values: &[f64]) -> Option<Self> {
        let mut elements = [0.0; MAX_ELEMENTS];
        elements.get_mut(..values.len())?.copy_from_slice(values);
        Some(Self { len: u8::try_from(values.len()).ok()?, values: elements })
    }

    /// The elements.
    pub fn as_slice(&self) -> &[f64] {
        &self.values[..usize::from(self.len).min(MAX_ELEMENTS)]
    }
}

const GAINS: &[ParameterSpec] = ImpedanceGains::<0>::ROWS;
const LIMITS: &[ParameterSpec] = Limits::<0>::ROWS;

/// The controllers' parameters; a parameter's number is its place in this table.
pub const CONTROLLER: [ParameterSpec; GAINS.len() + Corrections::ROWS.len() + LIMITS.len()] = {
    let mut rows = [GAINS[0]; GAINS.len() + Corrections::ROWS.len() + LIMITS.len()];
    let (corrections, limits) = (GAINS.len(), GAINS.len() + Corrections::ROWS.len());
    let mut i = 0;
    while i < rows.len() {
        rows[i] = if i < corrections {
            GAINS[i]
        } else if i < limits {
            Corrections::ROWS[i - corrections]
        } else {
            LIMITS[i - limits]
        };
        i += 1;
    }
    rows
};

/// The loop's period; configured as a rate, so it has no row of its own in [`CONTROLLER`].
const PERIOD: ParameterSpec =
    ParameterSpec::of::<f64>("period_s", "Nominal control period.").range(1e-4, 1e-2).units(&["s"]);

impl<const N: usize> Parameters<N> {
    /// Reports every parameter that is outside its range (NaN and infinity always are) to `report`.
    pub fn check(&self, mut report: impl FnMut(ParameterError)) {
        { *self }.each(&mut |row, field| {
            field.see(&mut |value| {
                if let FieldValue::Numbers(values) = value
                    && let Err(error) = row.check(values)
                {
                    report(error);
                }
            });
        });
        if let Err(error) = PERIOD.check(&[self.limits.period_s]) {
            report(error);
        }
    }

    /// Hands every parameter with its row to `visit`, in the order of [`CONTROLLER`].
    pub fn each(&mut self, visit: &mut dyn FnMut(&'static ParameterSpec, &mut dyn crate::table::Field)) {
        self.gains.each(visit);
        self.corrections.each(visit);
        self.limits.each(visit);
    }

    /// The parameter with this number in [`CONTROLLER`].
    pub fn get(&self, number: usize) -> Option<ParameterValues> {
        let (mut found, mut at) = (None, 0);
        { *self }.each(&mut |_, field| {
            if at == number {
                field.see(&mut |value| {
                    if let FieldValue::Numbers(values) = value {
                        found = ParameterValues::new(values);
                    }
                });
            }
            at += 1;
        });
        found
    }

    /// Changes the parameter with this number in [`CONTROLLER`], live or not.
    ///
    /// # Errors
    /// [`Refusal::NoSuchParameter`], or [`Refusal::OutOfRange`] for a value outside its range or a wrong number of
    /// values; nothing is changed.
    pub fn set(&mut self, number: usize, values: &ParameterValues) -> Result<(), Refusal> {
        let spec = CONTROLLER.get(number).ok_or(Refusal::NoSuchParameter)?;
        let values = values.as_slice();
        spec.check(values).map_err(|_| Refusal::OutOfRange)?;
        if self.put(number, values) { Ok(()) } else { Err(Refusal::OutOfRange) }
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values are handed over, not computed")]
mod tests {
    use super::*;

    /// Distinct values, so that a swapped row cannot go unseen.
    #[test]
    fn every_row_of_the_table_is_a_parameter_of_its_own() {
        for (number, spec) in CONTROLLER.iter().enumerate() {
            let mut parameters = Parameters::PAPER;
            let old = parameters.get(number).unwrap();
            let new = match spec.kind {
                ParameterKind::Flag => 1.0 - old.as_slice()[0],
                _ => 0.5 * (spec.min + old.as_slice()[0]) + 0.001,
            };
            let values = ParameterValues::new(&[new; MAX_ELEMENTS][..old.as_slice().len()]).unwrap();
            parameters.set(number, &values).unwrap();
            assert_eq!(parameters.get(number), Some(values), "{}", spec.name);
            let others = (0..CONTROLLER.len()).filter(|other| *other != number);
            for other in others {
                assert_eq!(parameters.get(other), Parameters::PAPER.get(other), "{} moved too", spec.name);
            }
            for bad in [spec.min - 1.0, spec.max + 1.0, f64::NAN, f64::INFINITY] {
                let values = ParameterValues::new(&[bad; MAX_ELEMENTS][..old.as_slice().len()]).unwrap();
                assert_eq!(
                    parameters.set(number, &values),
                    Err(Refusal::OutOfRange),
                    "{} = {bad}",
                    spec.name
                );
            }
            let none = ParameterValues::default();
            assert_eq!(parameters.set(number, &none), Err(Refusal::OutOfRange), "{}", spec.name);
        }
        let beyond = Parameters::PAPER.get(CONTROLLER.len());
        assert_eq!(beyond, None);
        Parameters::PAPER.check(|error| panic!("{error}"));
    }

    #[test]
    fn names_of_rows_lead_to_their_fields() {
        let mut parameters = Parameters::PAPER;
        let number = |name: &str| CONTROLLER.iter().position(|spec| spec.name.ends_with(name)).unwrap();
        let one = ParameterValues::new(&[2.5]).unwrap();
        parameters.set(number("eta_arm"), &one).unwrap();
        parameters.set(number("reactivity"), &one).unwrap();
        parameters.set(number("taxel_force_n"), &one).unwrap();
        assert_eq!(parameters.gains.eta_arm, 2.5);
        assert_eq!(parameters.gains.reactivity, 2.5);
        assert_eq!(parameters.limits.taxel_force_n, 2.5);
        parameters.set(number("flange_wrench_feedforward"), &ParameterValues::new(&[1.0]).unwrap()).unwrap();
        assert!(parameters.corrections.flange_wrench_feedforward);
        let speeds = ParameterValues::new(&[0.1, 0.2, 0.3]).unwrap();
        parameters.set(number("base_velocity"), &speeds).unwrap();
        assert_eq!(parameters.limits.base_velocity, [0.1, 0.2, 0.3]);
    }
}
