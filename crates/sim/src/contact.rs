//! Force between a person and the cover, from the geometric gap: tissue and foam in series and Coulomb friction, equal
//! and opposite on both bodies. MuJoCo's own contacts are for hard bodies and are not used.

use crate::foam::{Foam, FoamState, Memory};
use std::f64::consts::FRAC_1_SQRT_2;

/// Shear stiffness of the foam over its normal one, for a Poisson's ratio of about 0.3. ASSUMED.
const SHEAR_SHARE: f64 = 0.4;

/// Alexander's L-stable Runge–Kutta method of two stages and second order (SDIRK2): place of the first stage in the step
/// and weight of the second; the second stands at the step's end.
const GAMMA: f64 = 1.0 - FRAC_1_SQRT_2;
/// Share of dt²/m that a body yields in each stage. From 1/4 on a mass on a spring of any stiffness gains no energy; the same
/// in both stages, it makes no speed between them that would damp. Its effect vanishes with the square of the step.
const STAGE_YIELD: f64 = 0.5;

/// Tissue that presses on the foam: a spring and a damper in parallel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tissue {
    /// N/m.
    pub stiffness_n_per_m: f64,
    /// N·s/m.
    pub damping_n_s_per_m: f64,
}

/// Inputs of a contact at each step.
#[derive(Clone, Copy, Debug)]
pub struct Pressing<'a> {
    /// The cover's foam.
    pub foam: &'a Foam,
    /// Flesh in series with it.
    pub tissue: Tissue,
    /// Coulomb coefficient.
    pub friction: f64,
    /// Overlap of the outer surfaces, m; not positive without contact.
    pub overlap_m: f64,
    /// Speed of the body along the cover, m/s.
    pub sliding_m_s: f64,
    /// Step, s.
    pub dt_s: f64,
    /// dt²/m of the body that presses, m/N: how far its own reaction moves it within the step; 0 if it is fixed.
    pub yield_m_per_n: f64,
}

/// Force of a contact on the body that presses, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactForce {
    /// Out of the cover, ≥ 0.
    pub normal_n: f64,
    /// Along it, against the sliding.
    pub along_n: f64,
}

/// Memory of one contact: the foam's, the tissue's deformation of the last step, and how far the foam is sheared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactState {
    foam: FoamState,
    tissue_m: f64,
    shear_m: f64,
}

impl ContactState {
    /// Force of tissue and foam in series, and of friction along them.
    ///
    /// Solves foam(x) = tissue(overlap − x) for the foam's deformation x and moves both memories there. The body's own
    /// reaction within the step is part of the balance, so that a light body on a stiff or damped contact stays stable.
    pub fn step(&mut self, pressing: &Pressing<'_>) -> ContactForce {
        if pressing.overlap_m <= 0.0 {
            return ContactForce { normal_n: self.leave(pressing.foam, pressing.dt_s), along_n: 0.0 };
        }
        let (x_m, normal_n) = self.press(Memory::Exact, pressing);
        ContactForce { normal_n, along_n: self.friction_n(pressing, x_m, normal_n) }
    }

    /// Takes the step to second order: `middle` is the contact in the middle of the step, its overlap growing by `closing_m_s`.
    /// Returns the mean force over the step and the force at its end.
    ///
    /// The overlap is taken as linear over the step; the foam's memory goes through two stages of backward Euler.
    pub fn second_order(&mut self, middle: &Pressing<'_>, closing_m_s: f64) -> (ContactForce, ContactForce) {
        let stage = |share: f64| Pressing {
            overlap_m: middle.overlap_m + (share - 0.5) * middle.dt_s * closing_m_s,
            dt_s: GAMMA * middle.dt_s,
            yield_m_per_n: STAGE_YIELD * middle.yield_m_per_n,
            ..*middle
        };
        let (first, last) = (stage(GAMMA), stage(1.0));
        if first.overlap_m <= 0.0 && last.overlap_m <= 0.0 {
            self.leave(middle.foam, middle.dt_s);
            return Default::default();
        }
        let before = *self;
        let (first_m, first_n) = self.press_or_leave(&first);
        *self = before.towards(self, (1.0 - GAMMA) / GAMMA);
        let (last_m, last_n) = self.press_or_leave(&last);
        let mean = |first: f64, last: f64| (1.0 - GAMMA) * first + GAMMA * last;
        let (x_m, normal_n) = (mean(first_m, last_m), mean(first_n, last_n));
        let sliding = Pressing { yield_m_per_n: STAGE_YIELD * middle.yield_m_per_n, ..*middle };
        let along_n = self.friction_n(&sliding, x_m, normal_n);
        let share = if normal_n > 0.0 { last_n / normal_n } else { 0.0 };
        (ContactForce { normal_n, along_n }, ContactForce { normal_n: last_n, along_n: share * along_n })
    }

    /// A stage of [`ContactState::second_order`]: deformation of the foam, m, and normal force, N.
    fn press_or_leave(&mut self, stage: &Pressing<'_>) -> (f64, f64) {
        if stage.overlap_m > 0.0 {
            return self.press(Memory::BackwardEuler, stage);
        }
        self.tissue_m = 0.0;
        (0.0, self.foam.step_by(Memory::BackwardEuler, stage.foam, 0.0, stage.dt_s))
    }

    /// The state `share` times as far from this one as `there` is; the shear stays.
    fn towards(&self, there: &Self, share: f64) -> Self {
        Self {
            foam: self.foam.towards(&there.foam, share),
            tissue_m: self.tissue_m + share * (there.tissue_m - self.tissue_m),
            shear_m: self.shear_m,
        }
    }

    /// Deformation of the foam, m, and normal force, N, of tissue and foam in series.
    fn press(&mut self, memory: Memory, pressing: &Pressing<'_>) -> (f64, f64) {
        let &Pressing { foam, tissue, overlap_m, dt_s, yield_m_per_n, .. } = pressing;
        let damping = tissue.damping_n_s_per_m / dt_s;
        let stiffness = tissue.stiffness_n_per_m + damping;
        let damped_n = damping * self.tissue_m;
        let softened = 1.0 + stiffness * yield_m_per_n;
        // Tissue and the body's own way are one spring in series.
        let tissue_n = |deformation_m: f64| (stiffness * deformation_m - damped_n) / softened;
        let response = self.foam.response(memory, foam, dt_s);
        let residual = |x_m: f64| self.foam.force_n(&response, foam, x_m) - tissue_n(overlap_m - x_m);
        let x_m = root(residual, overlap_m);
        let normal_n = self.foam.go(&response, foam, x_m);
        self.tissue_m = overlap_m - x_m - normal_n * yield_m_per_n;
        (x_m, normal_n)
    }

    /// Nobody touches: the foam goes on by itself for `dt_s`. Gives its force on a plate that is gone, 0 N.
    pub(crate) fn leave(&mut self, foam: &Foam, dt_s: f64) -> f64 {
        (self.tissue_m, self.shear_m) = (0.0, 0.0);
        self.foam.step(foam, 0.0, dt_s)
    }

    /// The foam shears until Coulomb's limit, then the body slips.
    fn friction_n(&mut self, pressing: &Pressing<'_>, x_m: f64, normal_n: f64) -> f64 {
        let (limit_n, stiffness) = (pressing.friction * normal_n, SHEAR_SHARE * normal_n / x_m);
        if !(limit_n > 0.0 && stiffness > 0.0 && stiffness.is_finite()) {
            self.shear_m = 0.0;
            return 0.0;
        }
        let stiffness = stiffness / (1.0 + stiffness * pressing.yield_m_per_n);
        let most_m = limit_n / stiffness;
        self.shear_m = (self.shear_m + pressing.sliding_m_s * pressing.dt_s).clamp(-most_m, most_m);
        -stiffness * self.shear_m
    }
}

/// Zero of a rising function between 0 and `high`; 0 if it is positive there already.
///
/// Illinois keeps the bracket and converges fast; every fourth step halves it, for foams that start infinitely stiff
/// (an exponent below 1).
fn root(residual: impl Fn(f64) -> f64, high: f64) -> f64 {
    let (mut low, mut high) = (0.0, high);
    let (mut f_low, mut f_high) = (residual(low), residual(high));
    if f_low > 0.0 {
        return low;
    }
    let mut x_m = high;
    for iteration in 0..100 {
        let slope = f_high - f_low;
        if slope.abs() < f64::MIN_POSITIVE {
            break;
        }
        let halve = iteration % 4 == 3;
        x_m = if halve { 0.5 * (low + high) } else { high - f_high * (high - low) / slope };
        let f = residual(x_m);
        if f.abs() < 1e-9 || (high - low).abs() < 1e-15 {
            break;
        }
        if f * f_high < 0.0 {
            (low, f_low) = (high, f_high);
        } else {
            f_low *= 0.5;
        }
        (high, f_high) = (x_m, f);
    }
    x_m
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRM: Tissue = Tissue { stiffness_n_per_m: 5e4, damping_n_s_per_m: 0.0 };

    /// Pressed by a body that does not yield and does not slide.
    fn pressing(foam: &Foam, tissue: Tissue, overlap_m: f64) -> Pressing<'_> {
        Pressing { foam, tissue, friction: 0.0, overlap_m, sliding_m_s: 0.0, dt_s: 1e-3, yield_m_per_n: 0.0 }
    }

    #[test]
    fn tissue_and_foam_share_one_force() {
        for foam in [Foam::PU_LD30, Foam::COLLISION_ASSUMED, Foam::CC] {
            for tissue in [1e2, 5e4, 1e7] {
                let mut contact = ContactState::default();
                let mut alone = FoamState::default();
                let flesh = Tissue { stiffness_n_per_m: tissue, damping_n_s_per_m: 0.0 };
                for step in 1..200 {
                    let overlap_m = 1e-4 * f64::from(step.min(80));
                    let force_n = contact.step(&pressing(&foam, flesh, overlap_m)).normal_n;
                    // The foam alone, moved by what the tissue leaves, answers with the same force.
                    let x_m = overlap_m - force_n / tissue;
                    assert!(x_m >= -1e-12, "{foam:?} {tissue} {x_m}");
                    let expected_n = alone.step(&foam, x_m, 1e-3);
                    assert!(
                        (force_n - expected_n).abs() < 1e-6 * (1.0 + tissue * 1e-9 + force_n),
                        "{foam:?} {tissue} {force_n} {expected_n}"
                    );
                }
            }
        }
    }

    #[test]
    fn tissue_damping_adds_force_only_while_moving() {
        let press = |damping_n_s_per_m| {
            let tissue = Tissue { stiffness_n_per_m: 2e4, damping_n_s_per_m };
            let mut contact = ContactState::default();
            let overlaps = (1..=400).map(|step: i32| 1e-4 * f64::from(step.min(60)));
            let foam = Foam::COLLISION_ASSUMED;
            overlaps.map(|x| contact.step(&pressing(&foam, tissue, x)).normal_n).collect::<Vec<_>>()
        };
        let (plain, damped) = (press(0.0), press(200.0));
        assert!(damped[50] > 1.03 * plain[50], "{} {}", damped[50], plain[50]);
        assert!((damped[399] - plain[399]).abs() < 1e-3, "{} {}", damped[399], plain[399]);
    }

    #[test]
    fn friction_holds_until_the_limit_and_then_slips_at_it() {
        let foam = Foam::COLLISION_ASSUMED;
        let mut contact = ContactState::default();
        let mut forces = Vec::new();
        for _ in 0..4000 {
            let slow = Pressing { friction: 0.4, sliding_m_s: 0.002, ..pressing(&foam, FIRM, 0.006) };
            forces.push(contact.step(&slow));
        }
        // Sheared by 0.2 mm after 0.1 s: 0.4 of the normal secant stiffness; after 5.6 mm it slips.
        let (early, late) = (forces[99], forces[3999]);
        let x_m = 0.006 - early.normal_n / 5e4;
        let expected_n = -0.4 * early.normal_n / x_m * 0.2e-3;
        assert!((early.along_n / expected_n - 1.0).abs() < 1e-6, "{early:?} {expected_n}");
        assert!((late.along_n + 0.4 * late.normal_n).abs() < 1e-9, "{late:?}");
        let back = Pressing { friction: 0.4, sliding_m_s: -0.002, ..pressing(&foam, FIRM, 0.006) };
        assert!(contact.step(&back).along_n > late.along_n, "it springs back before it slips the other way");
        assert!(contact.step(&pressing(&foam, FIRM, 0.0)).along_n.abs() < f64::MIN_POSITIVE);
    }

    /// Semi-implicit Euler with the contact's force alone: a body thrown at the cover comes back slower.
    fn thrown(mass_kg: f64, speed_m_s: f64, foam: &Foam, tissue: Tissue, dt_s: f64) -> (f64, f64) {
        let (mut contact, mut overlap_m, mut speed, mut peak_n) =
            (ContactState::default(), 0.0, speed_m_s, 0.0f64);
        for _ in 0..10_000 {
            let now =
                Pressing { dt_s, yield_m_per_n: dt_s * dt_s / mass_kg, ..pressing(foam, tissue, overlap_m) };
            let force_n = contact.step(&now).normal_n;
            peak_n = peak_n.max(force_n);
            speed -= dt_s * force_n / mass_kg;
            overlap_m += dt_s * speed;
            if overlap_m < 0.0 {
                break;
            }
        }
        (speed, peak_n)
    }

    #[test]
    fn a_light_hard_body_thrown_at_damped_foam_gains_no_speed() {
        for mass_kg in [0.1, 0.6, 75.0] {
            for (stiffness_n_per_m, damping_n_s_per_m) in [(7.5e4, 0.0), (7.5e4, 2e3), (1e7, 0.0), (1e7, 2e4)]
            {
                for speed_m_s in [0.2, 1.0, 3.0] {
                    let tissue = Tissue { stiffness_n_per_m, damping_n_s_per_m };
                    let (speed, _) = thrown(mass_kg, speed_m_s, &Foam::COLLISION_ASSUMED, tissue, 1e-3);
                    assert!(
                        speed < 0.0 && speed > -speed_m_s,
                        "{mass_kg} kg {tissue:?} {speed_m_s}: {speed}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_light_hard_hand_that_crushes_the_foam_comes_to_rest() {
        let (mass_kg, push_n, dt_s) = (0.6, 500.0, 1e-3);
        let foam = Foam::COLLISION_ASSUMED;
        let tissue = Tissue { stiffness_n_per_m: 1e7, damping_n_s_per_m: 0.0 };
        let (mut contact, mut overlap_m, mut speed) = (ContactState::default(), 0.0, 0.0);
        let mut force_n = 0.0;
        for _ in 0..3000 {
            let now =
                Pressing { dt_s, yield_m_per_n: dt_s * dt_s / mass_kg, ..pressing(&foam, tissue, overlap_m) };
            force_n = contact.step(&now).normal_n;
            speed += dt_s * (push_n - force_n) / mass_kg;
            overlap_m += dt_s * speed;
        }
        assert!((force_n - push_n).abs() < 1e-3 && speed.abs() < 1e-6, "{force_n} N, {speed} m/s");
    }

    #[test]
    fn the_body_s_own_yield_vanishes_with_the_step() {
        let peak = |dt_s| thrown(0.6, 0.5, &Foam::COLLISION_ASSUMED, FIRM, dt_s).1;
        let (coarse, fine, finest) = (peak(1e-3), peak(1e-4), peak(1e-5));
        assert!((fine - finest).abs() < 0.2 * (coarse - finest).abs(), "{coarse} {fine} {finest}");
        assert!((coarse / finest - 1.0).abs() < 0.1, "{coarse} {finest}");
    }
}
