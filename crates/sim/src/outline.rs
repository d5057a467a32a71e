//! The cover seen from above: a convex polygon with rounded corners, and which taxel answers for which part of it.
//!
//! Its sides are the planes in which taxels lie and, where there is no taxel, the sides of the base's box. A corner
//! belongs half to either side. A cover with an inward corner is taken as its convex hull.

use crate::scene::{Scene, outward_base};
use moca_msgs::MAX_TAXELS;

/// Room for the largest cover.
const K: usize = MAX_TAXELS;
/// Directions closer than this, rad, are one side.
const SAME_SIDE_RAD: f64 = 1e-6;
/// A side shorter than this is none, m.
const SIDE_MIN_M: f64 = 1e-9;

/// A half plane `outward · p ≤ offset`, axes of B.
#[derive(Clone, Copy, Debug)]
struct Side {
    outward: [f64; 2],
    offset_m: f64,
}

/// A part of the outline that one taxel (or none) answers for.
#[derive(Clone, Copy, Debug)]
struct Strip {
    length_m: f64,
    /// 0 on a side, 1/radius on a corner.
    curvature_per_m: f64,
    /// 0 is T1.
    taxel: Option<usize>,
}

/// One side of the core polygon with the corner after it.
#[derive(Clone, Debug)]
struct Edge {
    start_base: [f64; 2],
    /// Counter-clockwise.
    along: [f64; 2],
    outward: [f64; 2],
    length_m: f64,
    /// Index of its first strip.
    strip: usize,
}

/// Outline of the cover: the core polygon, `radius_m` inside it, and the strips in counter-clockwise order.
#[derive(Clone, Debug)]
pub(crate) struct Outline {
    edges: Vec<Edge>,
    strips: Vec<Strip>,
    radius_m: f64,
    /// Out of the cover at each taxel, unit, axes of B.
    taxel_outward: Vec<[f64; 2]>,
}

/// The point of the outline that is nearest to some point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// Distance of the point from the outline, positive outside, m.
    pub(crate) distance_m: f64,
    /// Out of the cover, unit, axes of B.
    pub(crate) outward: [f64; 2],
    /// Nearest point in B, m.
    pub(crate) point_base: [f64; 2],
    strip: usize,
    /// From the start of the strip, m.
    along_m: f64,
}

/// Shares of the taxels in a contact's force; a share that falls on no taxel is missing from the sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shares(pub(crate) [f64; K]);

impl Edge {
    fn at(&self, along_m: f64) -> [f64; 2] {
        std::array::from_fn(|k| self.start_base[k] + along_m * self.along[k])
    }
}

impl Outline {
    /// The cover of `scene`. The corners are as round as the foam that is wrapped round them is thick. ASSUMED.
    pub(crate) fn new(scene: &Scene) -> Self {
        let radius_m = scene.foam.gap_m;
        let sides = sides(scene);
        let corners = sides.iter().fold(square(1e3), |polygon, side| cut(&polygon, side, radius_m));
        let taxel_outward = scene.cover.iter().map(outward_base).collect();
        let mut outline = Self { edges: Vec::new(), strips: Vec::new(), radius_m, taxel_outward };
        let edges: Vec<([f64; 2], [f64; 2], f64)> =
            (0..corners.len()).filter_map(|i| edge(corners[i], corners[(i + 1) % corners.len()])).collect();
        for (i, &(start_base, along, length_m)) in edges.iter().enumerate() {
            let outward = [along[1], -along[0]];
            let strip = outline.strips.len();
            let side_taxels = taxels_of(scene, outward, along, start_base);
            outline.lay_side(&side_taxels, length_m);
            let (next_start, next_along, _) = edges[(i + 1) % edges.len()];
            let next_outward = [next_along[1], -next_along[0]];
            let next_taxels = taxels_of(scene, next_outward, next_along, next_start);
            let turn = cross(along, next_along).atan2(dot(along, next_along));
            for taxel in [side_taxels.last(), next_taxels.first()] {
                outline.strips.push(Strip {
                    length_m: 0.5 * turn * radius_m,
                    curvature_per_m: 1.0 / radius_m,
                    taxel: taxel.map(|(taxel, _)| *taxel),
                });
            }
            outline.edges.push(Edge { start_base, along, outward, length_m, strip });
        }
        outline
    }

    /// One strip for each taxel of a side, borders half way between neighbours; the ends reach to the corners.
    fn lay_side(&mut self, taxels: &[(usize, f64)], length_m: f64) {
        if taxels.is_empty() {
            self.strips.push(Strip { length_m, curvature_per_m: 0.0, taxel: None });
        }
        let mut start_m = 0.0;
        for (i, &(taxel, at_m)) in taxels.iter().enumerate() {
            let end_m = taxels.get(i + 1).map_or(length_m, |(_, next_m)| 0.5 * (at_m + next_m));
            let end_m = end_m.clamp(start_m, length_m);
            let taxel = Some(taxel);
            self.strips.push(Strip { length_m: end_m - start_m, curvature_per_m: 0.0, taxel });
            start_m = end_m;
        }
    }

    /// Direction out of the cover at a taxel (0 is T1), unit, axes of B.
    pub(crate) fn taxel_outward_base(&self, taxel: usize) -> [f64; 2] {
        self.taxel_outward[taxel]
    }

    /// Returns true if one side alone shows that `point_base`, m, is further than this from the cover: cheaper than
    /// [`Outline::nearest`], and true of most bystanders.
    pub(crate) fn is_further_than(&self, distance_m: f64, point_base: [f64; 2]) -> bool {
        let height_m = |edge: &Edge| dot(edge.outward, difference(point_base, edge.start_base));
        self.edges.iter().any(|edge| height_m(edge) > distance_m + self.radius_m)
    }

    /// The point of the outline nearest to `point_base`, m. Inside the core the nearest side counts.
    pub(crate) fn nearest(&self, point_base: [f64; 2]) -> Nearest {
        let mut nearest =
            Nearest { distance_m: f64::INFINITY, outward: [0.0; 2], point_base, strip: 0, along_m: 0.0 };
        let mut inside: Option<(f64, &Edge)> = None;
        let mut outside = false;
        for edge in &self.edges {
            let away = difference(point_base, edge.start_base);
            let (height_m, along_m) = (dot(edge.outward, away), dot(edge.along, away));
            outside |= height_m > 0.0;
            if inside.is_none_or(|(most_m, _)| height_m > most_m) {
                inside = Some((height_m, edge));
            }
            let on_side = (0.0..=edge.length_m).contains(&along_m);
            let foot = edge.at(along_m.clamp(0.0, edge.length_m));
            let away = difference(point_base, foot);
            let distance_m = if on_side { height_m.abs() } else { away[0].hypot(away[1]) };
            if distance_m < nearest.distance_m && distance_m > 0.0 {
                let outward = if on_side { edge.outward } else { away.map(|v| v / distance_m) };
                // The corner before this side is the one after the side before it, which finds the same.
                if on_side || along_m > 0.0 {
                    let turned = if on_side {
                        0.0
                    } else {
                        cross(edge.outward, outward).atan2(dot(edge.outward, outward))
                    };
                    let (strip, along_m) =
                        self.locate(edge.strip, along_m.min(edge.length_m) + turned * self.radius_m);
                    nearest = Nearest { distance_m, outward, point_base: foot, strip, along_m };
                }
            }
        }
        if let (false, Some((height_m, edge))) = (outside, inside) {
            let along_m = dot(edge.along, difference(point_base, edge.start_base));
            let along_m = along_m.clamp(0.0, edge.length_m);
            let point_base = edge.at(along_m);
            let (strip, along_m) = self.locate(edge.strip, along_m);
            nearest = Nearest { distance_m: height_m, outward: edge.outward, point_base, strip, along_m };
        }
        nearest.distance_m -= self.radius_m;
        nearest.point_base =
            std::array::from_fn(|k| nearest.point_base[k] + self.radius_m * nearest.outward[k]);
        nearest
    }

    /// Strip and place in it, `along_m` after the start of strip `first`.
    fn locate(&self, first: usize, mut along_m: f64) -> (usize, f64) {
        let mut strip = first;
        while along_m > self.strips[strip].length_m && strip + 1 < self.strips.len() {
            along_m -= self.strips[strip].length_m;
            strip += 1;
        }
        (strip, along_m.min(self.strips[strip].length_m))
    }

    /// Shares of the taxels in a circle of `radius_m` that is `depth_m` deep at `nearest`: by the depth of the gap
    /// under it, integrated over what each taxel answers for (a Winkler foundation, circle and corner as parabolas).
    pub(crate) fn shares(&self, nearest: &Nearest, depth_m: f64, radius_m: f64) -> Shares {
        let mut shares = Shares([0.0; K]);
        let mut bare = 0.0;
        for forward in [true, false] {
            let (mut strip, mut left_m) = (nearest.strip, nearest.along_m);
            if forward {
                left_m = self.strips[strip].length_m - left_m;
            }
            let (mut depth_m, mut slope) = (depth_m, 0.0f64);
            for _ in 0..self.strips.len() {
                let bend = 1.0 / radius_m + self.strips[strip].curvature_per_m;
                let end_m = (slope + (slope * slope + 2.0 * bend * depth_m).max(0.0).sqrt()) / bend;
                let s = end_m.min(left_m);
                let area = depth_m * s + (0.5 * slope - bend * s / 6.0) * s * s;
                *self.strips[strip].taxel.map_or(&mut bare, |taxel| &mut shares.0[taxel]) += area;
                if end_m <= left_m {
                    break;
                }
                depth_m += (slope - 0.5 * bend * s) * s;
                slope -= bend * s;
                strip = (strip + if forward { 1 } else { self.strips.len() - 1 }) % self.strips.len();
                left_m = self.strips[strip].length_m;
            }
        }
        let areas = &mut shares.0[..self.taxel_outward.len()];
        let total = areas.iter().sum::<f64>() + bare;
        for area in areas {
            *area = if total > 0.0 { *area / total } else { 0.0 };
        }
        shares
    }

    /// Middles of the `count` plates of one side that are nearest to a place, axes of B, m, T1 first; none of the others, and fewer where
    /// the side has fewer.
    pub(crate) fn plates(&self, nearest: &Nearest, count: u8) -> [Option<[f64; 2]>; K] {
        let mut middles = [None; K];
        let edge = self.edges.iter().rfind(|edge| edge.strip <= nearest.strip);
        let Some(edge) = edge else { return middles };
        let at_m = dot(edge.along, difference(nearest.point_base, edge.start_base));
        let away_m = |[start_m, end_m]: [f64; 2]| (start_m - at_m).max(at_m - end_m).max(0.0);
        for _ in 0..count {
            let left = self.spans(edge).filter(|(taxel, _)| middles[*taxel].is_none());
            if let Some((taxel, span_m)) = left.min_by(|(_, a), (_, b)| away_m(*a).total_cmp(&away_m(*b))) {
                middles[taxel] = Some(self.on_side(edge, 0.5 * (span_m[0] + span_m[1])));
            }
        }
        middles
    }

    /// Taxels of a side, each with where its part begins and ends along it, m.
    fn spans(&self, edge: &Edge) -> impl Iterator<Item = (usize, [f64; 2])> {
        let mut start_m = 0.0;
        let straight = self.strips[edge.strip..].iter().take_while(|strip| strip.curvature_per_m <= 0.0);
        straight.filter_map(move |strip| {
            let span_m = [start_m, start_m + strip.length_m];
            start_m = span_m[1];
            strip.taxel.map(|taxel| (taxel, span_m))
        })
    }

    /// A place of the outline on a side, in B, m.
    fn on_side(&self, edge: &Edge, along_m: f64) -> [f64; 2] {
        let [x, y] = edge.at(along_m);
        [x + self.radius_m * edge.outward[0], y + self.radius_m * edge.outward[1]]
    }

    /// Ends of what `taxel` answers for on its side, in B, m: where a plane meets it first.
    pub(crate) fn ends(&self, taxel: usize) -> Option<[[f64; 2]; 2]> {
        self.edges.iter().find_map(|edge| {
            let (_, span_m) = self.spans(edge).find(|(of, _)| *of == taxel)?;
            Some(span_m.map(|along_m| self.on_side(edge, along_m)))
        })
    }
}

/// Every plane in which a taxel lies, and the sides of the base's box, moved out to the taxels if they are further out.
fn sides(scene: &Scene) -> Vec<Side> {
    let mut sides: Vec<Side> = Vec::new();
    for taxel in &scene.cover {
        let outward = outward_base(taxel);
        let offset_m = dot(outward, taxel.position_base_m);
        match sides.iter_mut().find(|side| same_direction(side.outward, outward)) {
            Some(side) => side.offset_m = side.offset_m.max(offset_m),
            None => sides.push(Side { outward, offset_m }),
        }
    }
    let [length_m, width_m, _] = scene.base.size_m;
    for (outward, half_m) in [([1.0, 0.0], 0.5 * length_m), ([0.0, 1.0], 0.5 * width_m)] {
        for outward in [outward, outward.map(|v: f64| -v)] {
            let furthest = scene.cover.iter().map(|taxel| dot(outward, taxel.position_base_m));
            sides.push(Side { outward, offset_m: furthest.fold(half_m, f64::max) });
        }
    }
    sides
}

/// Taxels of the side with this outward direction: index and place along it from `start`, m, in order.
fn taxels_of(scene: &Scene, outward: [f64; 2], along: [f64; 2], start: [f64; 2]) -> Vec<(usize, f64)> {
    let mut taxels: Vec<(usize, f64)> = (0..scene.cover.len())
        .filter(|&i| same_direction(outward_base(&scene.cover[i]), outward))
        .map(|i| (i, dot(along, difference(scene.cover[i].position_base_m, start))))
        .collect();
    taxels.sort_by(|a, b| a.1.total_cmp(&b.1));
    taxels
}

fn same_direction(a: [f64; 2], b: [f64; 2]) -> bool {
    cross(a, b).abs() < SAME_SIDE_RAD && dot(a, b) > 0.0
}

/// A square about the origin, counter-clockwise.
fn square(half_m: f64) -> Vec<[f64; 2]> {
    vec![[-half_m, -half_m], [half_m, -half_m], [half_m, half_m], [-half_m, half_m]]
}

/// Returns the part of a convex polygon that lies `inset_m` inside `side`.
fn cut(polygon: &[[f64; 2]], side: &Side, inset_m: f64) -> Vec<[f64; 2]> {
    let height = |point: [f64; 2]| dot(side.outward, point) - (side.offset_m - inset_m);
    let mut kept = Vec::new();
    for (i, &from) in polygon.iter().enumerate() {
        let to = polygon[(i + 1) % polygon.len()];
        let (a, b) = (height(from), height(to));
        if a <= 0.0 {
            kept.push(from);
        }
        if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
            let share = a / (a - b);
            kept.push(std::array::from_fn(|k| from[k] + share * (to[k] - from[k])));
        }
    }
    kept
}

/// Start, unit direction and length of a side that is long enough.
fn edge(from: [f64; 2], to: [f64; 2]) -> Option<([f64; 2], [f64; 2], f64)> {
    let way = difference(to, from);
    let length_m = way[0].hypot(way[1]);
    (length_m > SIDE_MIN_M).then(|| (from, way.map(|v| v / length_m), length_m))
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn difference(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::robot::{AnyArm, MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_4};

    const R: f64 = 0.015;

    fn scene() -> Scene {
        Scene::new(&AnyArm::of(&PANDA), &SUMMIT_XL, &MOCA_MOUNT, &PAPER_COVER)
    }

    fn outline() -> Outline {
        Outline::new(&scene())
    }

    /// Pressed taxels with their share, T1 is 1.
    fn pressed(shares: Shares) -> Vec<(usize, f64)> {
        shares.0.into_iter().enumerate().filter(|(_, s)| *s > 0.0).map(|(i, s)| (i + 1, s)).collect()
    }

    #[test]
    fn before_the_middle_of_a_taxel_it_is_a_plane() {
        for (i, taxel) in PAPER_COVER.iter().enumerate() {
            let ([x, y], [nx, ny]) = (taxel.position_base_m, outward_base(taxel));
            for distance_m in [-0.03, -0.005, 0.0, 0.3] {
                let nearest = outline().nearest([x + distance_m * nx, y + distance_m * ny]);
                assert!((nearest.distance_m - distance_m).abs() < 1e-12, "T{} {nearest:?}", i + 1);
                assert!((nearest.outward[0] - nx).hypot(nearest.outward[1] - ny) < 1e-12);
                assert!((nearest.point_base[0] - x).hypot(nearest.point_base[1] - y) < 1e-12);
                assert_eq!(pressed(outline().shares(&nearest, 0.006, 0.07)), [(i + 1, 1.0)]);
            }
        }
    }

    #[test]
    fn the_corner_is_round_and_shared_half_and_half() {
        // On the diagonal of the left front corner, 0.1 m from the centre of its arc.
        let (cx, cy) = (0.489 - R, 0.388 - R);
        let nearest = outline().nearest([cx + 0.1 * FRAC_1_SQRT_2, cy + 0.1 * FRAC_1_SQRT_2]);
        assert!((nearest.distance_m - (0.1 - R)).abs() < 1e-12, "{nearest:?}");
        assert!((nearest.outward[1].atan2(nearest.outward[0]) - FRAC_PI_4).abs() < 1e-12);
        let shares = pressed(outline().shares(&nearest, 0.006, 0.07));
        assert!(shares.len() == 2 && shares[0].0 == 4 && shares[1].0 == 5, "{shares:?}");
        assert!((shares[0].1 - 0.5).abs() < 1e-9, "{shares:?}");
    }

    #[test]
    fn a_seam_is_felt_by_both_and_the_rear_by_none() {
        let seam = outline().nearest([0.0, 0.4]);
        let shares = pressed(outline().shares(&seam, 0.006, 0.07));
        assert!(shares.len() == 2 && (shares[0].1 - 0.5).abs() < 1e-9, "{shares:?}");
        // A patch of 29 mm on either side: 20 mm from the seam most of it is on one taxel, 30 mm all.
        let shares = outline().shares(&outline().nearest([0.02, 0.4]), 0.006, 0.07).0;
        assert!(shares[2] > 0.9 && shares[1] > 0.01 && (shares[1] + shares[2] - 1.0).abs() < 1e-12);
        assert_eq!(pressed(outline().shares(&outline().nearest([0.03, 0.4]), 0.006, 0.07)), [(3, 1.0)]);
        let rear = outline().nearest([-0.5, 0.0]);
        assert!(
            (rear.distance_m - 0.011).abs() < 1e-12
                && pressed(outline().shares(&rear, 0.006, 0.07)).is_empty()
        );
    }

    #[test]
    fn distance_and_shares_have_no_jump_all_round() {
        let outline = outline();
        let mut last: Option<(f64, [f64; 2], Shares)> = None;
        let steps = 20_000;
        for i in 0..=steps {
            let angle = f64::from(i) / f64::from(steps) * std::f64::consts::TAU;
            // An ellipse that stays between 2 and 25 cm outside.
            let point = [0.75 * angle.cos(), 0.65 * angle.sin()];
            let nearest = outline.nearest(point);
            let shares = outline.shares(&nearest, 0.006, 0.07);
            if let Some((distance_m, outward, before)) = last {
                assert!((nearest.distance_m - distance_m).abs() < 3e-4, "{point:?} {nearest:?}");
                assert!((nearest.outward[0] - outward[0]).hypot(nearest.outward[1] - outward[1]) < 2e-2);
                for (a, b) in shares.0.iter().zip(before.0) {
                    assert!((a - b).abs() < 0.03, "{point:?} {shares:?} {before:?}");
                }
            }
            last = Some((nearest.distance_m, nearest.outward, shares));
        }
    }

    #[test]
    fn outline_follows_cover_and_invalid_has_none() {
        // The left side leans inwards by 45°: seven sides' worth of one octagon corner.
        let mut scene = scene();
        let position = &mut scene.cover[3];
        *position = moca_msgs::TaxelPlacement {
            position_base_m: [0.45, 0.35],
            inward_angle_base_rad: -3.0 * FRAC_PI_4,
        };
        let outline = Outline::new(&scene);
        let n = FRAC_1_SQRT_2;
        let nearest = outline.nearest([0.45 + 0.1 * n, 0.35 + 0.1 * n]);
        assert!((nearest.distance_m - 0.1).abs() < 1e-12, "{nearest:?}");
        assert_eq!(pressed(outline.shares(&nearest, 0.002, 0.07))[0].0, 4);
        for taxel in &mut scene.cover {
            taxel.inward_angle_base_rad += std::f64::consts::PI;
        }
        assert!(Outline::new(&scene).nearest([0.0, 1.0]).distance_m.is_infinite());
    }
}
