//! Foam of one taxel: elastic law, quasi-linear viscoelastic memory, and the plate gap it leaves.
//!
//! Pure functions of deformation (m), force (N) and time step (s). The power laws and their Prony series reproduce
//! the paper's Table I: **two numbers were fitted to two numbers a row, so they prove nothing about the material**;
//! the CC and PE rows are phenomenological. Compression is positive and a foam never pulls.

use crate::error::{SimError, within};
use moca_msgs::TrueFoam;

/// Shares of the relaxing part that decay with [`BRANCH_TIME_S`]; they sum to 1. ASSUMED.
pub const BRANCH_SHARE: [f64; 3] = [0.40, 0.35, 0.25];
/// Time constants of the Prony branches, s. ASSUMED.
pub const BRANCH_TIME_S: [f64; 3] = [0.2, 2.0, 20.0];
/// Force at which the table states deformation and counts, N.
pub const REFERENCE_FORCE_N: f64 = 100.0;

/// Elastic force Fe of a foam at deformation x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ElasticLaw {
    /// Fe = k·xⁿ.
    Power {
        /// Instantaneous modulus k, N/mmⁿ.
        modulus_n_per_mm_n: f64,
        /// Hardening exponent n.
        exponent: f64,
    },
    /// Fe = k₀·x/(1 − x/h), h being the plate gap at rest.
    Hyperbolic {
        /// Initial stiffness k₀, N/m.
        stiffness_n_per_m: f64,
    },
}

/// The foam under a plate: its mechanics, and the capacitor around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foam {
    /// Name shown to users.
    pub name: &'static str,
    /// Plate gap at rest, m: the foam's thickness.
    pub gap_m: f64,
    /// Elastic force.
    pub elastic: ElasticLaw,
    /// Damping over stiffness, s: a Kelvin–Voigt term in parallel; 0 for none.
    pub damping_time_s: f64,
    /// Relaxing share r of the elastic force.
    pub relaxation: f64,
    /// Largest deformation over three ramps 0 → 100 → 0 N of 10 s each way, as the table states it, m.
    pub deformation_at_100n_m: f64,
    /// Sensitivity a of s = N₀·a·u/(1 + a·u), u = x/(gap − x).
    pub sensitivity: f64,
    /// Standard deviation of one FDAT value, counts.
    pub noise_counts: f64,
}

impl Default for Foam {
    /// The paper's cover.
    fn default() -> Self {
        Self::PU_LD30
    }
}

/// Largest share of its force that a held foam may lose.
const RELAXATION_MAX: f64 = 0.99;

/// Fraction of the gap beyond which plate and foam are treated as one solid: keeps every law finite.
const SOLID_FRACTION: f64 = 0.999;

impl Foam {
    /// Polyurethane LD30, 15 mm: the paper's cover and the default.
    pub const PU_LD30: Self = Self {
        name: "PU LD30",
        gap_m: 0.015,
        elastic: ElasticLaw::Power { modulus_n_per_mm_n: 2.472, exponent: 1.586 },
        damping_time_s: 0.0,
        relaxation: 0.186,
        deformation_at_100n_m: 0.0114,
        sensitivity: 0.041_71,
        noise_counts: 0.70,
    };
    /// CC foam, 15 mm (its deformation at 100 N is ASSUMED: the paper prints NA).
    pub const CC: Self = Self {
        name: "CC foam",
        elastic: ElasticLaw::Power { modulus_n_per_mm_n: 21.86, exponent: 0.774 },
        relaxation: 0.381,
        sensitivity: 0.034_01,
        ..Self::PU_LD30
    };
    /// Polyethylene LD45, 5 mm.
    pub const PE5: Self = Self {
        name: "PE LD45 5 mm",
        gap_m: 0.005,
        elastic: ElasticLaw::Power { modulus_n_per_mm_n: 38.46, exponent: 1.0 },
        damping_time_s: 0.0,
        relaxation: 0.168,
        deformation_at_100n_m: 0.0030,
        sensitivity: 0.004_66,
        noise_counts: 0.65,
    };
    /// Polyethylene LD45, 3 mm (its plate gap is fitted, not the foam's thickness).
    pub const PE3: Self = Self {
        name: "PE LD45 3 mm",
        gap_m: 0.006,
        elastic: ElasticLaw::Power { modulus_n_per_mm_n: 39.71, exponent: 1.0 },
        damping_time_s: 0.0,
        relaxation: 0.166,
        deformation_at_100n_m: 0.0029,
        sensitivity: 0.005_97,
        noise_counts: 0.83,
    };
    /// The collision scene's foam in the PU taxel: gap, sensitivity and noise are PU's. ASSUMED.
    pub const COLLISION_ASSUMED: Self = Self {
        name: "collision (assumed)",
        elastic: ElasticLaw::Hyperbolic { stiffness_n_per_m: 2105.0 },
        damping_time_s: 0.005,
        relaxation: 0.0,
        ..Self::PU_LD30
    };

    /// The paper's four materials, in the order of Table I.
    pub const PAPER: [Self; 4] = [Self::PU_LD30, Self::CC, Self::PE5, Self::PE3];

    /// Checks the numbers that a scene may choose.
    pub(crate) fn check(&self) -> Result<(), SimError> {
        within("foam.thickness", "m", &[self.gap_m], 1e-3, 0.1)?;
        within("foam.damping_time", "s", &[self.damping_time_s], 0.0, 1.0)?;
        match self.elastic {
            ElasticLaw::Power { modulus_n_per_mm_n, exponent } => {
                within("foam.modulus", "N/mmⁿ", &[modulus_n_per_mm_n], 1e-3, 1e7)?;
                within("foam.exponent", "", &[exponent], 0.1, 10.0)?;
            }
            ElasticLaw::Hyperbolic { stiffness_n_per_m } => {
                within("foam.stiffness", "N/m", &[stiffness_n_per_m], 1.0, 1e9)?;
            }
        }
        within("foam.relaxation", "", &[self.relaxation], 0.0, RELAXATION_MAX)?;
        within("foam.sensitivity", "", &[self.sensitivity], 0.0, 1e3)
    }

    /// Returns the foam, `factor` times as stiff.
    #[must_use]
    pub fn stiffened(mut self, factor: f64) -> Self {
        match &mut self.elastic {
            ElasticLaw::Power { modulus_n_per_mm_n: k, .. }
            | ElasticLaw::Hyperbolic { stiffness_n_per_m: k } => *k *= factor,
        }
        self
    }

    /// Returns the foam as `truth` has it: otherwise stiff, and with more creep.
    #[must_use]
    pub fn as_is(self, truth: &TrueFoam) -> Self {
        let relaxation = (self.relaxation + truth.creep).min(RELAXATION_MAX).max(self.relaxation);
        Self { relaxation, ..self.stiffened(truth.scale) }
    }

    /// Deformation at which the foam is taken as solid, m.
    fn solid_m(&self) -> f64 {
        SOLID_FRACTION * self.gap_m
    }

    /// Instantaneous elastic force Fe at deformation `x_m`, N; 0 for `x_m` ≤ 0, finite for every finite `x_m`.
    pub fn elastic_force_n(&self, x_m: f64) -> f64 {
        if x_m <= 0.0 {
            return 0.0;
        }
        match self.elastic {
            ElasticLaw::Power { modulus_n_per_mm_n, exponent } => {
                modulus_n_per_mm_n * (1e3 * x_m).powf(exponent)
            }
            ElasticLaw::Hyperbolic { stiffness_n_per_m } => {
                let x = x_m.min(self.solid_m());
                stiffness_n_per_m * x / (1.0 - x / self.gap_m)
            }
        }
    }

    /// Slope dFe/dx at deformation `x_m` (at least 1 µm, where CC's exponent below 1 has a pole), N/m.
    pub fn stiffness_n_per_m(&self, x_m: f64) -> f64 {
        let x = x_m.max(1e-6);
        match self.elastic {
            ElasticLaw::Power { exponent, .. } => exponent * self.elastic_force_n(x) / x,
            ElasticLaw::Hyperbolic { stiffness_n_per_m } => {
                let rest = 1.0 - x.min(self.solid_m()) / self.gap_m;
                stiffness_n_per_m / (rest * rest)
            }
        }
    }

    /// Inverse of [`Self::elastic_force_n`], m; 0 for a force ≤ 0.
    pub fn deformation_m(&self, force_n: f64) -> f64 {
        if force_n <= 0.0 {
            return 0.0;
        }
        match self.elastic {
            ElasticLaw::Power { modulus_n_per_mm_n, exponent } => {
                1e-3 * (force_n / modulus_n_per_mm_n).powf(1.0 / exponent)
            }
            ElasticLaw::Hyperbolic { stiffness_n_per_m } => {
                let h = self.gap_m;
                (force_n * h / (stiffness_n_per_m * h + force_n)).min(self.solid_m())
            }
        }
    }

    /// Returns the deflection under a force held for some seconds, m: the elastic curve scaled to the table's 100 N point, which
    /// includes the relaxation.
    pub fn ramp_deformation_m(&self, force_n: f64) -> f64 {
        let at_reference = self.elastic_force_n(self.deformation_at_100n_m);
        self.deformation_m(force_n * at_reference / REFERENCE_FORCE_N)
    }

    /// Plate gap left at deformation `x_m`, m; never below a thousandth of the gap at rest.
    pub fn gap_left_m(&self, x_m: f64) -> f64 {
        self.gap_m - x_m.clamp(0.0, self.solid_m())
    }

    /// Relaxing share of each branch; all 0 for a foam without memory.
    fn branch_gain(&self) -> [f64; 3] {
        BRANCH_SHARE.map(|share| share * self.relaxation)
    }
}

/// Memory of one foam: the branch forces and the elastic force of the last step, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FoamState {
    branch_n: [f64; 3],
    elastic_n: f64,
}

/// Rule for the decay of the branches in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Memory {
    /// Exactly, for a force that is linear in time: a whole step.
    Exact,
    /// By backward Euler: a stage of an implicit Runge–Kutta method.
    BackwardEuler,
}

/// Force response of one step: F = offset + gain·ΔFe, from the exact solution for a force that is linear in time.
pub(crate) struct Response {
    offset_n: f64,
    gain: f64,
    decay: [f64; 3],
    branch_gain: [f64; 3],
}

impl Response {
    /// A foam never pulls, and not at all without deformation.
    fn force_n(&self, x_m: f64, change_n: f64) -> f64 {
        if x_m <= 0.0 { 0.0 } else { (self.offset_n + self.gain * change_n).max(0.0) }
    }
}

impl FoamState {
    /// Moves the foam to deformation `x_m` within `dt_s` and gives the force it answers with, N, ≥ 0.
    ///
    /// Stable for every `dt_s` > 0. An untouched foam at rest costs one comparison.
    pub fn step(&mut self, foam: &Foam, x_m: f64, dt_s: f64) -> f64 {
        self.step_by(Memory::Exact, foam, x_m, dt_s)
    }

    /// Takes a step with the given rule for the memory.
    pub(crate) fn step_by(&mut self, memory: Memory, foam: &Foam, x_m: f64, dt_s: f64) -> f64 {
        if x_m <= 0.0 && self.is_at_rest() {
            return 0.0;
        }
        let response = self.response(memory, foam, dt_s);
        self.go(&response, foam, x_m)
    }

    /// Ends the step that `response` is of at deformation `x_m`; gives the force, N, ≥ 0.
    pub(crate) fn go(&mut self, response: &Response, foam: &Foam, x_m: f64) -> f64 {
        if x_m <= 0.0 && self.is_at_rest() {
            return 0.0;
        }
        let change_n = foam.elastic_force_n(x_m) - self.elastic_n;
        self.advance(response, change_n);
        response.force_n(x_m, change_n)
    }

    /// The force that [`FoamState::go`] would give, N, ≥ 0.
    pub(crate) fn force_n(&self, response: &Response, foam: &Foam, x_m: f64) -> f64 {
        response.force_n(x_m, foam.elastic_force_n(x_m) - self.elastic_n)
    }

    /// Presses the foam with `force_n` for `dt_s` and gives the deformation it takes, m, ≥ 0 (a load-controlled
    /// test, as in the paper's characterisation).
    pub fn step_force(&mut self, foam: &Foam, force_n: f64, dt_s: f64) -> f64 {
        if force_n <= 0.0 && self.is_at_rest() {
            return 0.0;
        }
        let response = self.response(Memory::Exact, foam, dt_s);
        let change_n = (force_n.max(0.0) - response.offset_n) / response.gain;
        let change_n = change_n.max(-self.elastic_n);
        self.advance(&response, change_n);
        foam.deformation_m(self.elastic_n)
    }

    /// No deformation and no memory worth a force (below a micronewton).
    pub fn is_at_rest(&self) -> bool {
        self.elastic_n <= 1e-6 && self.branch_n.iter().all(|h| h.abs() < 1e-6)
    }

    /// The state `share` times as far from this one as `there` is.
    pub(crate) fn towards(&self, there: &Self, share: f64) -> Self {
        let beyond = |from: f64, to: f64| from + share * (to - from);
        Self {
            branch_n: std::array::from_fn(|i| beyond(self.branch_n[i], there.branch_n[i])),
            elastic_n: beyond(self.elastic_n, there.elastic_n).max(0.0),
        }
    }

    /// Returns the response of the foam in a step of `dt_s`. Out of line: a loop over bodies would otherwise take its exponentials
    /// with it, touched or not.
    #[inline(never)]
    pub(crate) fn response(&self, memory: Memory, foam: &Foam, dt_s: f64) -> Response {
        let share = foam.branch_gain();
        let held = 1.0 - foam.relaxation;
        let damping = foam.damping_time_s / dt_s;
        let mut response = Response {
            offset_n: held * self.elastic_n,
            gain: held + damping,
            decay: [1.0; 3],
            branch_gain: [0.0; 3],
        };
        if foam.relaxation > 0.0 {
            for i in 0..3 {
                let (decay, gain) = match memory {
                    Memory::Exact => {
                        let decay = (-dt_s / BRANCH_TIME_S[i]).exp();
                        (decay, share[i] * (1.0 - decay) * BRANCH_TIME_S[i] / dt_s)
                    }
                    Memory::BackwardEuler => {
                        let decay = 1.0 / (1.0 + dt_s / BRANCH_TIME_S[i]);
                        (decay, share[i] * decay)
                    }
                };
                (response.decay[i], response.branch_gain[i]) = (decay, gain);
                response.offset_n += self.branch_n[i] * decay;
                response.gain += response.branch_gain[i];
            }
        }
        response
    }

    fn advance(&mut self, response: &Response, change_n: f64) {
        for i in 0..3 {
            self.branch_n[i] = self.branch_n[i] * response.decay[i] + response.branch_gain[i] * change_n;
        }
        self.elastic_n += change_n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Foam; 5] = [Foam::PU_LD30, Foam::CC, Foam::PE5, Foam::PE3, Foam::COLLISION_ASSUMED];

    #[test]
    fn deformation_inverts_elastic_force_for_every_foam() {
        for foam in ALL {
            for force_n in [0.01, 1.0, 25.0, 100.0, 150.0] {
                let back_n = foam.elastic_force_n(foam.deformation_m(force_n));
                assert!((back_n - force_n).abs() < 1e-9 * force_n, "{foam:?} {force_n} {back_n}");
                let share =
                    |x_m| foam.elastic_force_n(x_m) / foam.elastic_force_n(foam.deformation_at_100n_m);
                let back_n = REFERENCE_FORCE_N * share(foam.ramp_deformation_m(force_n));
                assert!((back_n - force_n).abs() < 1e-9 * force_n, "{foam:?} {force_n} {back_n}");
            }
        }
    }

    #[test]
    fn three_ramps_to_100_n_reach_the_table_s_deformation() {
        for foam in Foam::PAPER {
            let mut state = FoamState::default();
            let mut deepest_m: f64 = 0.0;
            for i in 0..3 * 2000 {
                let force_n = 0.1 * f64::from(1000 - (i % 2000 - 1000i32).abs());
                deepest_m = deepest_m.max(state.step_force(&foam, force_n, 0.01));
            }
            let table_m = foam.deformation_at_100n_m;
            assert!((deepest_m - table_m).abs() < 0.002 * table_m, "{foam:?}: {deepest_m} against {table_m}");
        }
    }

    #[test]
    fn force_and_deformation_steps_are_inverse_to_each_other() {
        for foam in ALL {
            let (mut by_force, mut by_deformation) = (FoamState::default(), FoamState::default());
            for i in 1..500 {
                let force_n = 50.0 * (1.0 - (f64::from(i) * 0.02).cos());
                let x_m = by_force.step_force(&foam, force_n, 0.002);
                let back_n = by_deformation.step(&foam, x_m, 0.002);
                if x_m > 0.0 {
                    assert!((back_n - force_n).abs() < 1e-6, "{foam:?} step {i}: {force_n} {back_n}");
                }
            }
        }
    }

    #[test]
    fn a_held_deformation_relaxes_to_the_held_share() {
        let foam = Foam::PU_LD30;
        let mut state = FoamState::default();
        let first_n = state.step(&foam, 0.008, 1e-6);
        assert!((first_n - foam.elastic_force_n(0.008)).abs() < 1e-3);
        let mut last_n = first_n;
        for _ in 0..4000 {
            let force_n = state.step(&foam, 0.008, 0.1);
            assert!(force_n <= last_n + 1e-12);
            last_n = force_n;
        }
        assert!((last_n / first_n - (1.0 - 0.186)).abs() < 1e-4);
    }

    #[test]
    fn every_law_stays_finite_when_crushed_and_never_pulls() {
        for foam in ALL {
            for dt_s in [1e-6, 1e-3, 1.0, 1e3] {
                let mut state = FoamState::default();
                for x_m in [0.0, 0.02, 1.0, 0.014, -1.0, 0.0, 0.003] {
                    let force_n = state.step(&foam, x_m, dt_s);
                    assert!(force_n.is_finite() && force_n >= 0.0, "{foam:?} {x_m} {dt_s}: {force_n}");
                    assert!(foam.gap_left_m(x_m) > 0.0);
                }
            }
        }
    }

    #[test]
    fn thickness_stiffness_and_damping_are_what_their_law_says() {
        let plain = Foam::COLLISION_ASSUMED;
        let thin = Foam { gap_m: 0.010, ..plain };
        // k₀·x/(1 − x/h) at 6 mm.
        assert!((plain.elastic_force_n(0.006) - 2105.0 * 0.006 / 0.6).abs() < 1e-9);
        assert!((thin.elastic_force_n(0.006) - 2105.0 * 0.006 / 0.4).abs() < 1e-9);
        assert!(
            (thin.gap_left_m(0.006) - 0.004).abs() < 1e-15
                && thin.counts_drop(0.006) > plain.counts_drop(0.006)
        );
        for foam in ALL {
            let twice = foam.stiffened(2.0).elastic_force_n(0.001) / foam.elastic_force_n(0.001);
            assert!((twice - 2.0).abs() < 1e-12, "{foam:?}");
            // A Kelvin–Voigt damper adds its time over the step's to the elastic force of a first step.
            let first_n = |foam: &Foam| FoamState::default().step(foam, 0.001, 1e-3);
            let added_n = first_n(&Foam { damping_time_s: 0.002, ..foam })
                - first_n(&Foam { damping_time_s: 0.0, ..foam });
            assert!((added_n - 2.0 * foam.elastic_force_n(0.001)).abs() < 1e-9, "{foam:?}");
        }
    }
}
