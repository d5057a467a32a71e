//! Parameters of the controllers. Defaults are the gains that reproduce the paper's text; the paper gives none
//! (ASSUMED, tuned in simulation), so every one of them is configuration.

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

impl ImpedanceGains<7> {
    /// The gains that reproduce the paper's text on a Panda.
    pub const PAPER: Self = Self {
        virtual_mass: [4.0, 4.0, 2.0],
        virtual_damping: [80.0, 80.0, 60.0],
        stiffness: [800.0, 800.0, 800.0, 40.0, 40.0, 40.0],
        damping_ratio: 0.9,
        eta_base: 3.0,
        eta_arm: 1.0,
        posture_stiffness: [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0],
        posture_damping: [10.0, 10.0, 10.0, 10.0, 5.0, 3.5, 1.7],
        posture_rad: crate::robot::PANDA.home_rad,
        reactivity: 1.0,
    };
}

/// Corrections of what the literal law leaves out. All off is the paper's law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Corrections {
    /// Move −D_v v_d of eq. (2) into τ_0, so that the base's damping no longer drags the flange.
    pub null_space_damping: bool,
    /// Feed forward the inertial coupling M_AB q̈_B that eq. (3) ignores.
    pub base_coupling: bool,
    /// Let the base feel a force at the flange: add J_Bᵀ F̂_ext to eq. (2).
    pub flange_feed: bool,
}

impl Corrections {
    /// The paper's law to the letter.
    pub const LITERAL: Self = Self { null_space_damping: false, base_coupling: false, flange_feed: false };
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
    /// Nominal control period, s: rate limits credit no more time than this, however late a step is.
    pub period_s: f64,
}

impl Limits<7> {
    /// Panda torque limits and torque rate (libfranka), SUMMIT-XL acceleration; speeds ASSUMED for use near people.
    pub const PANDA_ON_SUMMIT: Self = Self {
        torque_nm: crate::robot::PANDA.torque_max_nm,
        torque_rate_nm_s: 1000.0,
        base_velocity: [0.5, 0.5, 0.8],
        base_acceleration: [3.0, 3.0, 6.0],
        taxel_force_n: 200.0,
        period_s: 1e-3,
    };
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

impl Parameters<7> {
    /// The paper's experiments: literal law, gains that reproduce the text.
    pub const PAPER: Self = Self {
        gains: ImpedanceGains::PAPER,
        corrections: Corrections::LITERAL,
        limits: Limits::PANDA_ON_SUMMIT,
    };
}

/// A parameter outside its range: which, its value, its unit and what is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterError {
    /// Name as in the configuration file.
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

impl<const N: usize> Parameters<N> {
    /// Reports every value that is outside its range (NaN and infinity always are) to `report`.
    pub fn check(&self, mut report: impl FnMut(ParameterError)) {
        let Self { gains: g, corrections: _, limits: l } = self;
        let mut within = |name, unit, values: &[f64], min: f64, max: f64| {
            for &value in values {
                if !(value >= min && value <= max) {
                    report(ParameterError { name, value, unit, min, max });
                }
            }
        };
        within("virtual_mass", "kg, kg, kg·m²", &g.virtual_mass, 0.01, 1000.0);
        within("virtual_damping", "N·s/m, N·s/m, N·m·s/rad", &g.virtual_damping, 0.0, 1e5);
        within("stiffness", "N/m, N·m/rad", &g.stiffness, 0.0, 1e5);
        within("damping_ratio", "", &[g.damping_ratio], 0.0, 5.0);
        within("eta_base", "", &[g.eta_base], 1e-3, 1e3);
        within("eta_arm", "", &[g.eta_arm], 1e-3, 1e3);
        within("posture_stiffness", "N·m/rad", &g.posture_stiffness, 0.0, 1e4);
        within("posture_damping", "N·m·s/rad", &g.posture_damping, 0.0, 1e3);
        within("posture_rad", "rad", &g.posture_rad, -7.0, 7.0);
        within("reactivity", "", &[g.reactivity], 0.0, 10.0);
        within("torque_nm", "N·m", &l.torque_nm, 0.0, 1e3);
        within("torque_rate_nm_s", "N·m/s", &[l.torque_rate_nm_s], 1.0, 1e5);
        within("base_velocity", "m/s, m/s, rad/s", &l.base_velocity, 0.0, 3.0);
        within("base_acceleration", "m/s², m/s², rad/s²", &l.base_acceleration, 0.01, 50.0);
        within("taxel_force_n", "N", &[l.taxel_force_n], 1.0, 1e4);
        within("period_s", "s", &[l.period_s], 1e-4, 1e-2);
    }
}
