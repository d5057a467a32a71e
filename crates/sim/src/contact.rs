//! Force between a person and the cover, from the geometric gap: tissue and foam in series, equal and opposite on
//! both bodies. Frictionless; MuJoCo's own contacts are for hard bodies and are not used.

use crate::foam::{FoamLaw, FoamState};
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

/// Force of tissue (linear, no memory) and foam in series at `overlap_m` of their outer surfaces, N ≥ 0.
///
/// Solves foam(x) = k_t (overlap − x) for the foam's deformation x and moves the foam's memory there.
pub fn series_force_n(
    foam: &mut FoamState,
    law: FoamLaw,
    tissue_n_per_m: f64,
    overlap_m: f64,
    dt_s: f64,
) -> f64 {
    if overlap_m <= 0.0 {
        return foam.step(law, 0.0, dt_s);
    }
    // Rising in x: negative at 0, not negative at the overlap. Illinois keeps the bracket and converges fast.
    let before = *foam;
    let residual = |x_m: f64| {
        let mut trial = before;
        trial.step(law, x_m, dt_s) - tissue_n_per_m * (overlap_m - x_m)
    };
    let (mut low, mut high) = (0.0, overlap_m);
    let (mut f_low, mut f_high) = (residual(low), residual(high));
    let mut x_m = high;
    for _ in 0..60 {
        let slope = f_high - f_low;
        if slope.abs() < f64::MIN_POSITIVE {
            break;
        }
        x_m = high - f_high * (high - low) / slope;
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
    foam.step(law, x_m, dt_s)
}
