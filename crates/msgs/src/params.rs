//! Parameters of the controllers. Defaults are the gains that reproduce the paper's text; the paper gives none
//! (ASSUMED, tuned in simulation), so every one of them is configuration. [`CONTROLLER`] is their schema: the one place
//! where names, units, ranges and descriptions are.

use crate::Refusal;
use crate::robot::{ArmTable, PANDA};

/// Gains of the expanded controllers, eqs. (2), (9)–(11), (15)–(16).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImpedanceGains<const N: usize> {
    /// Virtual mass of the base: kg, kg, kg·m². eq. (2)
    pub virtual_mass: [f64; 3],
    /// Virtual damping of the base: N·s/m, N·s/m, N·m·s/rad. eq. (2)
    pub virtual_damping: [f64; 3],
    /// Cartesian stiffness of the flange: N/m ×3, N·m/rad ×3. eq. (10)
    pub stiffness: [f64; 6],
    /// Damping ratio: D_d = A√K + √K A with A = ζ Λ^½. eq. (10)
    pub damping_ratio: f64,
    /// Weight of the base in H. eq. (9)
    pub eta_base: f64,
    /// Weight of the arm in H. eq. (9)
    pub eta_arm: f64,
    /// Null-space posture stiffness, N·m/rad. eq. (11)
    pub posture_stiffness: [f64; N],
    /// Null-space posture damping, N·m·s/rad. eq. (11)
    pub posture_damping: [f64; N],
    /// Null-space posture, rad. eq. (11)
    pub posture_rad: [f64; N],
    /// Scale of τ_v,ext, the external wrench on the base: the cover's, and in eq. (12) the flange's (end of section
    /// IV-A).
    pub reactivity: f64,
}

impl<const N: usize> ImpedanceGains<N> {
    /// The gains that reproduce the paper's text on a Panda, with posture and posture gains of `arm`. The flange's
    /// stiffness and the base's virtual mass and damping are felt by a hand: they do not depend on the arm.
    pub const fn for_arm(arm: &ArmTable<N>) -> Self {
        Self {
            virtual_mass: [4.0, 4.0, 2.0],
            virtual_damping: [80.0, 80.0, 60.0],
            stiffness: [800.0, 800.0, 800.0, 40.0, 40.0, 40.0],
            damping_ratio: 0.9,
            eta_base: 3.0,
            eta_arm: 1.0,
            posture_stiffness: arm.posture_stiffness_nm_rad,
            posture_damping: arm.posture_damping_nm_s_rad,
            posture_rad: arm.home_rad,
            reactivity: 1.0,
        }
    }
}

impl ImpedanceGains<7> {
    /// The gains that reproduce the paper's text on a Panda.
    pub const PAPER: Self = Self::for_arm(&PANDA);
}

/// Corrections of what the literal law leaves out. All off is the paper's law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Corrections {
    /// Move −D_v v_d of eq. (2) into τ_0, so that the base's damping no longer drags the flange.
    pub null_space_damping: bool,
    /// Feed forward the inertial coupling M_AB q̈_B that eq. (3) ignores.
    pub base_coupling: bool,
    /// Let the base feel a force at the flange: add J_Bᵀ F̂_ext to eq. (2).
    pub flange_wrench_feedforward: bool,
}

impl Corrections {
    /// The paper's law to the letter.
    pub const LITERAL: Self =
        Self { null_space_damping: false, base_coupling: false, flange_wrench_feedforward: false };
}

/// Limits on what a controller may give out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits<const N: usize> {
    /// Joint torque, N·m.
    pub torque_nm: [f64; N],
    /// Joint torque rate, N·m/s.
    pub torque_rate_nm_s: f64,
    /// Base speed along each axis of B, m/s, m/s, rad/s.
    pub base_velocity: [f64; 3],
    /// Base acceleration along each axis of B, m/s², m/s², rad/s².
    pub base_acceleration: [f64; 3],
    /// Largest force believed from one taxel, N.
    pub taxel_force_n: f64,
    /// Speed of the controlled frame in W beyond which a moving law stops, m/s.
    pub flange_speed_m_s: f64,
    /// Distance of the controlled frame from where it is wanted beyond which a moving law stops, m.
    pub pose_error_m: f64,
    /// Angle to its wanted orientation beyond which a moving law stops, rad.
    pub pose_error_rad: f64,
    /// Nominal control period, s: rate limits credit no more time than this, however late a step is.
    pub period_s: f64,
}

impl<const N: usize> Limits<N> {
    /// Torques of `arm`, the torque rate of Franka's arms (`libfranka`), SUMMIT-XL acceleration; speeds ASSUMED for use
    /// near people.
    pub const fn for_arm(arm: &ArmTable<N>) -> Self {
        Self {
            torque_nm: arm.torque_max_nm,
            torque_rate_nm_s: 1000.0,
            base_velocity: [0.5, 0.5, 0.8],
            base_acceleration: [3.0, 3.0, 6.0],
            taxel_force_n: 200.0,
            // above what base limits and reference speed add up to
            flange_speed_m_s: 1.0,
            // beyond the error that the law acts on (0.1 m, 0.5 rad) it no longer holds its tool
            pose_error_m: 0.2,
            pose_error_rad: 0.8,
            period_s: 1e-3,
        }
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

impl Parameters<7> {
    /// The paper's experiments: literal law, gains that reproduce the text.
    pub const PAPER: Self = Self::for_arm(&PANDA);
}

/// A parameter outside its range: which, its value, its unit and what is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterError {
    /// Dotted name as in the configuration file.
    pub name: &'static str,
    /// The offending value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
}

impl core::fmt::Display for ParameterError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { name, value, unit, min, max } = self;
        let space = if unit.is_empty() { "" } else { " " };
        write!(f, "{name} = {value}{space}{unit} is outside {min} to {max}{space}{unit}")
    }
}

impl core::error::Error for ParameterError {}

/// What a parameter may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterKind {
    /// A number, or a list of them.
    Number,
    /// A whole number, or a list of them.
    Integer,
    /// True or false; 1 or 0 where it travels as a number.
    Flag,
    /// Text.
    Text,
    /// One of these words.
    Choice(&'static [&'static str]),
}

/// One row of the schema of parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterSpec {
    /// Dotted name as in the configuration file.
    pub name: &'static str,
    /// What it may hold.
    pub kind: ParameterKind,
    /// Unit of each element, or one for all of them; empty where there is none.
    pub units: &'static [&'static str],
    /// Smallest allowed value; of no meaning for text and choices.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
    /// Whether it can be changed while the loop runs.
    pub live: bool,
    /// One line for the user.
    pub description: &'static str,
}

impl ParameterSpec {
    /// A row; not live unless [`ParameterSpec::live`] says so.
    pub const fn new(
        name: &'static str,
        kind: ParameterKind,
        units: &'static [&'static str],
        range: (f64, f64),
        description: &'static str,
    ) -> Self {
        Self { name, kind, units, min: range.0, max: range.1, live: false, description }
    }

    /// The same row, changeable while the loop runs.
    #[must_use]
    pub const fn live(self) -> Self {
        Self { live: true, ..self }
    }

    /// Unit of an element.
    pub fn unit(&self, element: usize) -> &'static str {
        self.units.get(element).or(self.units.last()).copied().unwrap_or("")
    }

    /// The first element of `values` outside the range, as an error that names it. NaN and infinity always are.
    ///
    /// # Errors
    /// Value, unit and range of the offending element.
    pub fn check(&self, values: &[f64]) -> Result<(), ParameterError> {
        for (element, &value) in values.iter().enumerate() {
            let whole = matches!(self.kind, ParameterKind::Number) || value % 1.0 == 0.0;
            if !(value >= self.min && value <= self.max && whole) {
                let (name, unit) = (self.name, self.unit(element));
                return Err(ParameterError { name, value, unit, min: self.min, max: self.max });
            }
        }
        Ok(())
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

/// The controllers' parameters; a parameter's number is its place in this table.
pub const CONTROLLER: [ParameterSpec; 21] = {
    use ParameterKind::{Flag, Number};
    const BASE: &[&str] = &["m/s", "m/s", "rad/s"];
    [
        ParameterSpec::new(
            "control.gains.virtual_mass",
            Number,
            &["kg", "kg", "kg·m²"],
            (0.01, 1000.0),
            "Virtual mass of the base, M_v of eq. (2); at least 0.5 with null_space_damping.",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.virtual_damping",
            Number,
            &["N·s/m", "N·s/m", "N·m·s/rad"],
            (0.0, 1e5),
            "Virtual damping of the base, D_v of eq. (2).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.stiffness",
            Number,
            &["N/m", "N/m", "N/m", "N·m/rad", "N·m/rad", "N·m/rad"],
            (0.0, 1e5),
            "Cartesian stiffness of the flange, K_d of eq. (10).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.damping_ratio",
            Number,
            &[],
            (0.0, 5.0),
            "Damping ratio of D_d, eq. (10).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.eta_base",
            Number,
            &[],
            (1e-3, 1e3),
            "Weight of the base in H, eq. (9).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.eta_arm",
            Number,
            &[],
            (1e-3, 1e3),
            "Weight of the arm in H, eq. (9).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.posture_stiffness",
            Number,
            &["N·m/rad"],
            (0.0, 1e4),
            "Null-space posture stiffness, K_0 of eq. (11).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.posture_damping",
            Number,
            &["N·m·s/rad"],
            (0.0, 1e3),
            "Null-space posture damping, D_0 of eq. (11).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.posture_rad",
            Number,
            &["rad"],
            (-7.0, 7.0),
            "Null-space posture of eq. (11).",
        )
        .live(),
        ParameterSpec::new(
            "control.gains.reactivity",
            Number,
            &[],
            (0.0, 10.0),
            "Scale of the cover's wrench on the base.",
        )
        .live(),
        ParameterSpec::new(
            "control.corrections.null_space_damping",
            Flag,
            &[],
            (0.0, 1.0),
            "Keep the base's virtual damping from dragging the flange.",
        )
        .live(),
        ParameterSpec::new(
            "control.corrections.base_coupling",
            Flag,
            &[],
            (0.0, 1.0),
            "Feed forward the base's acceleration to the arm.",
        )
        .live(),
        ParameterSpec::new(
            "control.corrections.flange_wrench_feedforward",
            Flag,
            &[],
            (0.0, 1.0),
            "Let the base feel a force at the flange (needs a trusted flange wrench).",
        )
        .live(),
        ParameterSpec::new("limits.torque_nm", Number, &["N·m"], (0.0, 1e3), "Largest joint torque."),
        ParameterSpec::new(
            "limits.torque_rate_nm_s",
            Number,
            &["N·m/s"],
            (1.0, 1e5),
            "Largest rate of a joint torque.",
        ),
        ParameterSpec::new(
            "limits.base_velocity",
            Number,
            BASE,
            (0.0, 3.0),
            "Largest base velocity along each axis of B.",
        )
        .live(),
        ParameterSpec::new(
            "limits.base_acceleration",
            Number,
            &["m/s²", "m/s²", "rad/s²"],
            (0.01, 50.0),
            "Largest base acceleration along each axis of B.",
        )
        .live(),
        ParameterSpec::new(
            "limits.taxel_force_n",
            Number,
            &["N"],
            (1.0, 1e4),
            "Largest force believed from one taxel.",
        )
        .live(),
        ParameterSpec::new(
            "limits.flange_speed_m_s",
            Number,
            &["m/s"],
            (0.01, 3.0),
            "Speed of the flange beyond which the robot stops.",
        ),
        ParameterSpec::new(
            "limits.pose_error_m",
            Number,
            &["m"],
            (0.001, 1.0),
            "Distance of the flange from where it is wanted beyond which the robot stops.",
        ),
        ParameterSpec::new(
            "limits.pose_error_rad",
            Number,
            &["rad"],
            (0.01, 3.2),
            "Angle of the flange to its wanted orientation beyond which the robot stops.",
        ),
    ]
};

/// The loop's period; configured as a rate, so it has no row of its own in [`CONTROLLER`].
const PERIOD: ParameterSpec =
    ParameterSpec::new("period_s", ParameterKind::Number, &["s"], (1e-4, 1e-2), "Nominal control period.");

enum Slot<'a> {
    Numbers(&'a mut [f64]),
    Flag(&'a mut bool),
}

impl<const N: usize> Parameters<N> {
    /// Reports every parameter that is outside its range (NaN and infinity always are) to `report`.
    pub fn check(&self, mut report: impl FnMut(ParameterError)) {
        for (number, spec) in CONTROLLER.iter().enumerate() {
            let values = self.get(number).unwrap_or_default();
            if let Err(error) = spec.check(values.as_slice()) {
                report(error);
            }
        }
        if let Err(error) = PERIOD.check(&[self.limits.period_s]) {
            report(error);
        }
    }

    /// The parameter with this number in [`CONTROLLER`].
    pub fn get(&self, number: usize) -> Option<ParameterValues> {
        match { *self }.slot(number)? {
            Slot::Numbers(values) => ParameterValues::new(values),
            Slot::Flag(flag) => ParameterValues::new(&[f64::from(u8::from(*flag))]),
        }
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
        match (self.slot(number).ok_or(Refusal::NoSuchParameter)?, values) {
            (Slot::Numbers(slot), values) if slot.len() == values.len() => slot.copy_from_slice(values),
            (Slot::Flag(flag), [value]) => *flag = *value > 0.5,
            _ => return Err(Refusal::OutOfRange),
        }
        Ok(())
    }

    fn slot(&mut self, number: usize) -> Option<Slot<'_>> {
        let Self { gains: g, corrections: c, limits: l } = self;
        Some(match number {
            0 => Slot::Numbers(&mut g.virtual_mass),
            1 => Slot::Numbers(&mut g.virtual_damping),
            2 => Slot::Numbers(&mut g.stiffness),
            3 => Slot::Numbers(core::slice::from_mut(&mut g.damping_ratio)),
            4 => Slot::Numbers(core::slice::from_mut(&mut g.eta_base)),
            5 => Slot::Numbers(core::slice::from_mut(&mut g.eta_arm)),
            6 => Slot::Numbers(&mut g.posture_stiffness),
            7 => Slot::Numbers(&mut g.posture_damping),
            8 => Slot::Numbers(&mut g.posture_rad),
            9 => Slot::Numbers(core::slice::from_mut(&mut g.reactivity)),
            10 => Slot::Flag(&mut c.null_space_damping),
            11 => Slot::Flag(&mut c.base_coupling),
            12 => Slot::Flag(&mut c.flange_wrench_feedforward),
            13 => Slot::Numbers(&mut l.torque_nm),
            14 => Slot::Numbers(core::slice::from_mut(&mut l.torque_rate_nm_s)),
            15 => Slot::Numbers(&mut l.base_velocity),
            16 => Slot::Numbers(&mut l.base_acceleration),
            17 => Slot::Numbers(core::slice::from_mut(&mut l.taxel_force_n)),
            18 => Slot::Numbers(core::slice::from_mut(&mut l.flange_speed_m_s)),
            19 => Slot::Numbers(core::slice::from_mut(&mut l.pose_error_m)),
            20 => Slot::Numbers(core::slice::from_mut(&mut l.pose_error_rad)),
            _ => return None,
        })
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
