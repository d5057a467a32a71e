//! Force between a person and the cover, from the geometric gap: tissue and foam in series, equal and opposite on
//! both bodies. Frictionless; MuJoCo's own contacts are for hard bodies and are not used.

use crate::foam::{Foam, FoamState};
use moca_msgs::TaxelPlacement;

/// Where a cylinder is in front of the cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// Taxel that feels it, 0 is T1.
    pub taxel: usize,
    /// Distance of the centre from the taxel's outer surface along the outward normal, m.
    pub distance_m: f64,
    /// Offset of the centre from the taxel's centre along the panel (the outward normal turned by +90°), m.
    pub offset_m: f64,
}

/// Half of the panel length that a taxel answers for, m: neighbours on one panel share it without gaps.
fn half_width_m(cover: &[TaxelPlacement], taxel: usize) -> f64 {
    let same_panel = |other: &&TaxelPlacement| {
        (other.inward_angle_base_rad - cover[taxel].inward_angle_base_rad).abs() < 1e-9
    };
    let [x, y] = cover[taxel].position_base_m;
    let nearest = cover
        .iter()
        .filter(same_panel)
        .map(|other| (other.position_base_m[0] - x).hypot(other.position_base_m[1] - y))
        .filter(|distance| *distance > 1e-9)
        .fold(f64::INFINITY, f64::min);
    0.5 * nearest
}

/// A cover with the width of every zone worked out.
#[derive(Clone, Copy, Debug)]
pub struct Zones<const K: usize> {
    cover: [TaxelPlacement; K],
    outward: [[f64; 2]; K],
    half_width_m: [f64; K],
}

impl<const K: usize> Zones<K> {
    /// Zones of `cover`.
    pub fn new(cover: [TaxelPlacement; K]) -> Self {
        let outward = cover.map(|taxel| {
            let (sin, cos) = taxel.inward_angle_base_rad.sin_cos();
            [-cos, -sin]
        });
        let mut half = [0.0; K];
        for (i, half) in half.iter_mut().enumerate() {
            *half = half_width_m(&cover, i);
        }
        Self { cover, outward, half_width_m: half }
    }

    /// Direction out of the cover at a taxel, unit, axes of B.
    pub fn outward(&self, taxel: usize) -> [f64; 2] {
        self.outward[taxel]
    }

    /// Centre of a taxel in B, m.
    pub fn position_base(&self, taxel: usize) -> [f64; 2] {
        self.cover[taxel].position_base_m
    }

    /// Half of the panel length that a taxel answers for, m.
    pub fn half_width_m(&self, taxel: usize) -> f64 {
        self.half_width_m[taxel]
    }

    /// The zone in front of which a point in B lies, if it is within `reach_m` of the surface on either side.
    pub fn find(&self, point_base: [f64; 2], reach_m: f64) -> Option<Zone> {
        (0..K).find_map(|taxel| {
            let [nx, ny] = self.outward[taxel];
            let [x, y] = self.cover[taxel].position_base_m;
            let (dx, dy) = (point_base[0] - x, point_base[1] - y);
            let zone = Zone { taxel, distance_m: dx * nx + dy * ny, offset_m: -dx * ny + dy * nx };
            (zone.offset_m.abs() <= self.half_width_m[taxel] && zone.distance_m.abs() <= reach_m)
                .then_some(zone)
        })
    }
}

/// What presses on the foam: a spring and a damper in parallel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tissue {
    /// N/m.
    pub stiffness_n_per_m: f64,
    /// N·s/m.
    pub damping_n_s_per_m: f64,
}

/// Memory of one contact: the foam's, and the tissue's deformation of the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactState {
    foam: FoamState,
    tissue_m: f64,
}

impl ContactState {
    /// Force of tissue and foam in series at `overlap_m` of their outer surfaces, N ≥ 0.
    ///
    /// Solves foam(x) = tissue(overlap − x) for the foam's deformation x and moves both memories there.
    pub fn step(&mut self, foam: &Foam, tissue: Tissue, overlap_m: f64, dt_s: f64) -> f64 {
        if overlap_m <= 0.0 {
            self.tissue_m = 0.0;
            return self.foam.step(foam, 0.0, dt_s);
        }
        let before = *self;
        let damping = tissue.damping_n_s_per_m / dt_s;
        let tissue_n = |deformation_m: f64| {
            tissue.stiffness_n_per_m * deformation_m + damping * (deformation_m - before.tissue_m)
        };
        let residual = |x_m: f64| before.foam.clone().step(foam, x_m, dt_s) - tissue_n(overlap_m - x_m);
        let x_m = root(residual, overlap_m);
        self.tissue_m = overlap_m - x_m;
        self.foam.step(foam, x_m, dt_s)
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
    use moca_msgs::robot::PAPER_COVER;

    #[test]
    fn tissue_and_foam_share_one_force() {
        for foam in [Foam::PU_LD30, Foam::COLLISION_ASSUMED, Foam::CC] {
            for tissue in [1e2, 5e4, 1e7] {
                let mut contact = ContactState::default();
                let mut alone = FoamState::default();
                let flesh = Tissue { stiffness_n_per_m: tissue, damping_n_s_per_m: 0.0 };
                for step in 1..200 {
                    let overlap_m = 1e-4 * f64::from(step.min(80));
                    let force_n = contact.step(&foam, flesh, overlap_m, 1e-3);
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
    fn damping_of_the_tissue_adds_force_while_pressed_in_and_none_when_held() {
        let press = |damping_n_s_per_m| {
            let tissue = Tissue { stiffness_n_per_m: 2e4, damping_n_s_per_m };
            let mut contact = ContactState::default();
            let overlaps = (1..=400).map(|step: i32| 1e-4 * f64::from(step.min(60)));
            overlaps.map(|x| contact.step(&Foam::COLLISION_ASSUMED, tissue, x, 1e-3)).collect::<Vec<_>>()
        };
        let (plain, damped) = (press(0.0), press(200.0));
        assert!(damped[50] > 1.03 * plain[50], "{} {}", damped[50], plain[50]);
        assert!((damped[399] - plain[399]).abs() < 1e-3, "{} {}", damped[399], plain[399]);
    }

    #[test]
    fn every_point_before_a_panel_has_exactly_one_zone() {
        let zones = Zones::new(PAPER_COVER);
        for step in -48..=48 {
            let x = 0.01 * f64::from(step);
            let zone = zones.find([x, 0.4], 0.1).unwrap();
            let nearest = (0..4).min_by(|a, b| {
                let off = |i: &usize| (PAPER_COVER[*i].position_base_m[0] - x).abs();
                off(a).total_cmp(&off(b))
            });
            assert_eq!(Some(zone.taxel), nearest);
            assert!((zone.distance_m - 0.012).abs() < 1e-12);
        }
        assert_eq!(zones.find([0.0, 2.0], 0.1), None);
    }
}
