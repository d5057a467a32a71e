//! Foam of one taxel: elastic law, quasi-linear viscoelastic memory, and the plate gap it leaves.
//!
//! Pure functions of deformation (m), force (N) and time step (s). The power laws and their Prony series reproduce
//! the paper's Table I: **two numbers were fitted to two numbers a row, so they prove nothing about the material**;
//! the CC and PE rows are phenomenological. Compression is positive and a foam never pulls.

/// Shares of the relaxing part that decay with [`BRANCH_TIME_S`]; they sum to 1. ASSUMED.
pub const BRANCH_SHARE: [f64; 3] = [0.40, 0.35, 0.25];
/// Time constants of the Prony branches, s. ASSUMED.
pub const BRANCH_TIME_S: [f64; 3] = [0.2, 2.0, 20.0];
/// Force at which the table states deformation and counts, N.
pub const REFERENCE_FORCE_N: f64 = 100.0;

/// The foam under the plate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FoamLaw {
    /// Polyurethane LD30, 15 mm: the paper's cover and the default.
    #[default]
    PuLd30,
    /// CC foam, 15 mm (its deformation at 100 N is ASSUMED: the paper prints NA).
    Cc,
    /// Polyethylene LD45, 5 mm.
    Pe5,
    /// Polyethylene LD45, 3 mm (its plate gap is fitted, not the foam's thickness).
    Pe3,
    /// Hyperbolic law F = k₀ d/(1 − d/h) with 5 ms of damping: the collision scene's foam. ASSUMED.
    CollisionAssumed,
}

/// Constants of one foam and of the capacitor around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoamTable {
    /// Name shown to users.
    pub name: &'static str,
    /// Plate gap at rest, m.
    pub gap_m: f64,
    /// Largest deformation over three ramps 0 → 100 → 0 N of 10 s each way, m.
    pub deformation_at_100n_m: f64,
    /// Hardening exponent n of Fe = k·xⁿ.
    pub exponent: f64,
    /// Instantaneous modulus k, N/mmⁿ.
    pub modulus_n_per_mm_n: f64,
    /// Relaxing share r of the elastic force.
    pub relaxation: f64,
    /// Sensitivity a of s = N₀·a·u/(1 + a·u), u = x/(gap − x).
    pub sensitivity: f64,
    /// Standard deviation of one FDAT value, counts.
    pub noise_counts: f64,
}

const PU_LD30: FoamTable = FoamTable {
    name: "PU LD30",
    gap_m: 0.015,
    deformation_at_100n_m: 0.0114,
    exponent: 1.586,
    modulus_n_per_mm_n: 2.472,
    relaxation: 0.186,
    sensitivity: 0.041_71,
    noise_counts: 0.70,
};
const CC: FoamTable = FoamTable {
    name: "CC foam",
    gap_m: 0.015,
    deformation_at_100n_m: 0.0114,
    exponent: 0.774,
    modulus_n_per_mm_n: 21.86,
    relaxation: 0.381,
    sensitivity: 0.034_01,
    noise_counts: 0.70,
};
const PE5: FoamTable = FoamTable {
    name: "PE LD45 5 mm",
    gap_m: 0.005,
    deformation_at_100n_m: 0.0030,
    exponent: 1.0,
    modulus_n_per_mm_n: 38.46,
    relaxation: 0.168,
    sensitivity: 0.004_66,
    noise_counts: 0.65,
};
const PE3: FoamTable = FoamTable {
    name: "PE LD45 3 mm",
    gap_m: 0.006,
    deformation_at_100n_m: 0.0029,
    exponent: 1.0,
    modulus_n_per_mm_n: 39.71,
    relaxation: 0.166,
    sensitivity: 0.005_97,
    noise_counts: 0.83,
};
/// The collision foam sits in the PU taxel: gap, sensitivity and noise are PU's, the force law is hyperbolic.
const COLLISION: FoamTable =
    FoamTable { name: "collision (assumed)", exponent: 1.0, relaxation: 0.0, ..PU_LD30 };

/// Initial stiffness k₀ of the collision foam, N/m.
const COLLISION_STIFFNESS_N_PER_M: f64 = 2105.0;
/// Thickness h of the collision foam, m.
const COLLISION_THICKNESS_M: f64 = 0.015;
/// Damping of the collision foam over its stiffness, s.
const COLLISION_DAMPING_TIME_S: f64 = 0.005;
/// Fraction of the gap beyond which plate and foam are treated as one solid: keeps every law finite.
const SOLID_FRACTION: f64 = 0.999;

impl FoamLaw {
    /// The paper's four materials, in the order of Table I.
    pub const PAPER: [Self; 4] = [Self::PuLd30, Self::Cc, Self::Pe5, Self::Pe3];

    /// Constants of this foam.
    pub const fn table(self) -> &'static FoamTable {
        match self {
            Self::PuLd30 => &PU_LD30,
            Self::Cc => &CC,
            Self::Pe5 => &PE5,
            Self::Pe3 => &PE3,
            Self::CollisionAssumed => &COLLISION,
        }
    }

    /// Instantaneous elastic force Fe at deformation `x_m`, N; 0 for `x_m` ≤ 0, finite for every finite `x_m`.
    pub fn elastic_force_n(self, x_m: f64) -> f64 {
        if x_m <= 0.0 {
            return 0.0;
        }
        let table = self.table();
        if self == Self::CollisionAssumed {
            let x = x_m.min(SOLID_FRACTION * COLLISION_THICKNESS_M);
            return COLLISION_STIFFNESS_N_PER_M * x / (1.0 - x / COLLISION_THICKNESS_M);
        }
        table.modulus_n_per_mm_n * (1e3 * x_m).powf(table.exponent)
    }

    /// Slope dFe/dx at deformation `x_m` (at least 1 µm, where CC's exponent below 1 has a pole), N/m.
    pub fn stiffness_n_per_m(self, x_m: f64) -> f64 {
        let x = x_m.max(1e-6);
        if self == Self::CollisionAssumed {
            let rest = 1.0 - x.min(SOLID_FRACTION * COLLISION_THICKNESS_M) / COLLISION_THICKNESS_M;
            return COLLISION_STIFFNESS_N_PER_M / (rest * rest);
        }
        self.table().exponent * self.elastic_force_n(x) / x
    }

    /// Inverse of [`Self::elastic_force_n`], m; 0 for a force ≤ 0.
    pub fn deformation_m(self, force_n: f64) -> f64 {
        if force_n <= 0.0 {
            return 0.0;
        }
        let table = self.table();
        if self == Self::CollisionAssumed {
            let h = COLLISION_THICKNESS_M;
            return (force_n * h / (COLLISION_STIFFNESS_N_PER_M * h + force_n)).min(SOLID_FRACTION * h);
        }
        1e-3 * (force_n / table.modulus_n_per_mm_n).powf(1.0 / table.exponent)
    }

    /// Force that belongs to deformation `x_m` on the elastic curve scaled to the table's 100 N point (relaxation
    /// of some seconds included), N.
    pub fn ramp_force_n(self, x_m: f64) -> f64 {
        let table = self.table();
        let at_reference = self.elastic_force_n(table.deformation_at_100n_m);
        REFERENCE_FORCE_N * self.elastic_force_n(x_m) / at_reference
    }

    /// Inverse of [`Self::ramp_force_n`], m: where a force held for some seconds leaves the plate.
    pub fn ramp_deformation_m(self, force_n: f64) -> f64 {
        let at_reference = self.elastic_force_n(self.table().deformation_at_100n_m);
        self.deformation_m(force_n * at_reference / REFERENCE_FORCE_N)
    }

    /// Plate gap left at deformation `x_m`, m; never below a thousandth of the gap at rest.
    pub fn gap_m(self, x_m: f64) -> f64 {
        let rest = self.table().gap_m;
        rest - x_m.clamp(0.0, SOLID_FRACTION * rest)
    }

    /// Relaxing share of each branch; all 0 for a foam without memory.
    fn branch_gain(self) -> [f64; 3] {
        BRANCH_SHARE.map(|share| share * self.table().relaxation)
    }

    /// Damping time of a Kelvin–Voigt term in parallel, s.
    const fn damping_time_s(self) -> f64 {
        match self {
            Self::CollisionAssumed => COLLISION_DAMPING_TIME_S,
            _ => 0.0,
        }
    }
}

/// Memory of one foam: the branch forces and the elastic force of the last step, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FoamState {
    branch_n: [f64; 3],
    elastic_n: f64,
}

/// Force response of one step: F = offset + gain·ΔFe, from the exact solution for a force that is linear in time.
struct Response {
    offset_n: f64,
    gain: f64,
    decay: [f64; 3],
    branch_gain: [f64; 3],
}

impl FoamState {
    /// Moves the foam to deformation `x_m` within `dt_s` and gives the force it answers with, N, ≥ 0.
    ///
    /// Stable for every `dt_s` > 0. An untouched foam at rest costs one comparison.
    pub fn step(&mut self, law: FoamLaw, x_m: f64, dt_s: f64) -> f64 {
        if x_m <= 0.0 && self.is_at_rest() {
            return 0.0;
        }
        let response = self.response(law, dt_s);
        let change_n = law.elastic_force_n(x_m) - self.elastic_n;
        self.advance(&response, change_n);
        if x_m <= 0.0 {
            return 0.0;
        }
        (response.offset_n + response.gain * change_n).max(0.0)
    }

    /// Presses the foam with `force_n` for `dt_s` and gives the deformation it takes, m, ≥ 0 (a load-controlled
    /// test, as in the paper's characterisation).
    pub fn step_force(&mut self, law: FoamLaw, force_n: f64, dt_s: f64) -> f64 {
        if force_n <= 0.0 && self.is_at_rest() {
            return 0.0;
        }
        let response = self.response(law, dt_s);
        let change_n = (force_n.max(0.0) - response.offset_n) / response.gain;
        let change_n = change_n.max(-self.elastic_n);
        self.advance(&response, change_n);
        law.deformation_m(self.elastic_n)
    }

    /// No deformation and no memory worth a force (below a micronewton).
    pub fn is_at_rest(&self) -> bool {
        self.elastic_n <= 1e-6 && self.branch_n.iter().all(|h| h.abs() < 1e-6)
    }

    fn response(&self, law: FoamLaw, dt_s: f64) -> Response {
        let share = law.branch_gain();
        let held = 1.0 - law.table().relaxation;
        let damping = law.damping_time_s() / dt_s;
        let mut response = Response {
            offset_n: held * self.elastic_n,
            gain: held + damping,
            decay: [1.0; 3],
            branch_gain: [0.0; 3],
        };
        if law.table().relaxation > 0.0 {
            for i in 0..3 {
                let decay = (-dt_s / BRANCH_TIME_S[i]).exp();
                response.decay[i] = decay;
                response.branch_gain[i] = share[i] * (1.0 - decay) * BRANCH_TIME_S[i] / dt_s;
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

    const ALL: [FoamLaw; 5] =
        [FoamLaw::PuLd30, FoamLaw::Cc, FoamLaw::Pe5, FoamLaw::Pe3, FoamLaw::CollisionAssumed];

    #[test]
    fn deformation_inverts_elastic_force_for_every_foam() {
        for law in ALL {
            for force_n in [0.01, 1.0, 25.0, 100.0, 150.0] {
                let back_n = law.elastic_force_n(law.deformation_m(force_n));
                assert!((back_n - force_n).abs() < 1e-9 * force_n, "{law:?} {force_n} {back_n}");
                let back_n = law.ramp_force_n(law.ramp_deformation_m(force_n));
                assert!((back_n - force_n).abs() < 1e-9 * force_n, "{law:?} {force_n} {back_n}");
            }
        }
    }

    #[test]
    fn three_ramps_to_100_n_reach_the_table_s_deformation() {
        for law in FoamLaw::PAPER {
            let mut foam = FoamState::default();
            let mut deepest_m: f64 = 0.0;
            for i in 0..3 * 2000 {
                let force_n = 0.1 * f64::from(1000 - (i % 2000 - 1000i32).abs());
                deepest_m = deepest_m.max(foam.step_force(law, force_n, 0.01));
            }
            let table_m = law.table().deformation_at_100n_m;
            assert!((deepest_m - table_m).abs() < 0.002 * table_m, "{law:?}: {deepest_m} against {table_m}");
        }
    }

    #[test]
    fn force_and_deformation_steps_are_inverse_to_each_other() {
        for law in ALL {
            let (mut by_force, mut by_deformation) = (FoamState::default(), FoamState::default());
            for i in 1..500 {
                let force_n = 50.0 * (1.0 - (f64::from(i) * 0.02).cos());
                let x_m = by_force.step_force(law, force_n, 0.002);
                let back_n = by_deformation.step(law, x_m, 0.002);
                if x_m > 0.0 {
                    assert!((back_n - force_n).abs() < 1e-6, "{law:?} step {i}: {force_n} {back_n}");
                }
            }
        }
    }

    #[test]
    fn a_held_deformation_relaxes_to_the_held_share() {
        let law = FoamLaw::PuLd30;
        let mut foam = FoamState::default();
        let first_n = foam.step(law, 0.008, 1e-6);
        assert!((first_n - law.elastic_force_n(0.008)).abs() < 1e-3);
        let mut last_n = first_n;
        for _ in 0..4000 {
            let force_n = foam.step(law, 0.008, 0.1);
            assert!(force_n <= last_n + 1e-12);
            last_n = force_n;
        }
        assert!((last_n / first_n - (1.0 - 0.186)).abs() < 1e-4);
    }

    #[test]
    fn every_law_stays_finite_when_crushed_and_never_pulls() {
        for law in ALL {
            for dt_s in [1e-6, 1e-3, 1.0, 1e3] {
                let mut foam = FoamState::default();
                for x_m in [0.0, 0.02, 1.0, 0.014, -1.0, 0.0, 0.003] {
                    let force_n = foam.step(law, x_m, dt_s);
                    assert!(force_n.is_finite() && force_n >= 0.0, "{law:?} {x_m} {dt_s}: {force_n}");
                    assert!(law.gap_m(x_m) > 0.0);
                }
            }
        }
    }
}
