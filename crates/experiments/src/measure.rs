//! Measures of a trace that every experiment reports.

use crate::TAXELS;
use crate::closed_loop::Row;
use serde::Serialize;

/// Windows after the first contact, s.
const FIRST_TOUCH_S: f64 = 0.1;
const IMPACT_S: f64 = 0.5;
/// A peak lower than this is a graze, N.
const PEAK_MIN_N: f64 = 2.0;

/// Measures of a whole trace.
#[derive(Clone, Debug, Serialize)]
pub struct Measures {
    /// Largest true force on any one body, N; on a seam two taxels share it.
    pub peak_force_n: f64,
    /// Largest force within the first 0.1 s of contact, which no law can prevent, N.
    pub first_touch_n: f64,
    /// Largest force within the first 0.5 s of contact, the transient of ISO/TS 15066, N.
    pub impact_n: f64,
    /// Local maxima of the total true force on the cover, N, in time order.
    pub peaks_n: Vec<f64>,
    /// Largest total true force of each contact, from touch to release, N, in time order.
    pub contacts_n: Vec<f64>,
    /// Taxels that were touched, in the order of the cover.
    pub contact_taxels: Vec<String>,
    /// First contact, s after the run's start; null without one.
    pub contact_s: Option<f64>,
    /// Time in contact, s.
    pub contact_time_s: f64,
    /// Distance of the flange from its target: root mean square and largest, mm.
    pub flange_rms_mm: f64,
    /// Largest distance of the flange from its target, mm.
    pub flange_max_mm: f64,
    /// Pose of the base at the end less that at the start, world axes: m, m, rad.
    pub base_displacement: [f64; 3],
    /// Turn of the base from first to last contact, degrees.
    pub yaw_in_contact_deg: f64,
    /// Wrench of the cover on the base, mean while in contact, axes of B about its origin: N, N, N·m.
    pub wrench_true: [f64; 3],
    /// As `wrench_true`, as the controller believes it.
    pub wrench_sensed: [f64; 3],
}

impl Measures {
    /// Measures rows that are `period_s` apart, s.
    pub fn of(rows: &[Row], period_s: f64) -> Self {
        // rows are large and many: one way through them, and the others through what was found
        let (mut totals_n, mut largest_n, mut errors_m) = (Vec::new(), Vec::new(), Vec::new());
        let (mut touching, mut touched) = (Vec::new(), [false; TAXELS]);
        for column in [&mut totals_n, &mut largest_n, &mut errors_m] {
            column.reserve_exact(rows.len());
        }
        for row in rows {
            totals_n.push(row.total_force_n);
            largest_n.push(row.largest_force_n);
            errors_m.push(row.flange_error_m());
            if row.total_force_n > 0.0 {
                touching.push(row);
                for (touched, force_n) in touched.iter_mut().zip(row.force_true) {
                    *touched |= force_n > 0.0;
                }
            }
        }
        let (first, last) = (touching.first(), touching.last());
        let start = totals_n.iter().position(|force_n| *force_n > 0.0).unwrap_or(rows.len());
        let within_n = |window_s: f64| {
            let contact = &rows[start..];
            let count = contact.partition_point(|row| row.t_s < contact[0].t_s + window_s);
            most(&largest_n[start..start + count])
        };
        Self {
            peak_force_n: most(&largest_n),
            first_touch_n: within_n(FIRST_TOUCH_S),
            impact_n: within_n(IMPACT_S),
            peaks_n: peaks(&totals_n),
            contacts_n: contacts(&totals_n),
            contact_taxels: (1..)
                .zip(touched)
                .filter(|(_, touched)| *touched)
                .map(|(number, _)| format!("T{number}"))
                .collect(),
            contact_s: first.map(|row| row.t_s),
            contact_time_s: period_s * to_f64(touching.len()),
            flange_rms_mm: 1e3 * rms(errors_m.iter().copied()),
            flange_max_mm: 1e3 * most(&errors_m),
            base_displacement: match (rows.first(), rows.last()) {
                (Some(first), Some(last)) => difference(&last.base_pose_world, &first.base_pose_world),
                _ => [0.0; 3],
            },
            yaw_in_contact_deg: match (first, last) {
                (Some(first), Some(last)) => {
                    (last.base_pose_world[2] - first.base_pose_world[2]).to_degrees()
                }
                _ => 0.0,
            },
            wrench_true: mean(&touching, |row| row.wrench_true),
            wrench_sensed: mean(&touching, |row| row.wrench_sensed),
        }
    }
}

/// Largest force on any one body, N.
pub fn peak_force_n(rows: &[Row]) -> f64 {
    rows.iter().map(|row| row.largest_force_n).fold(0.0, f64::max)
}

/// The largest of some values, or 0.
fn most(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn mean(rows: &[&Row], pick: fn(&Row) -> [f64; 3]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for value in rows.iter().map(|row| pick(row)) {
        sum = std::array::from_fn(|axis| sum[axis] + value[axis]);
    }
    sum.map(|s| s / to_f64(rows.len().max(1)))
}

/// Local maxima of the total force above a graze, N, each the largest between two dips of a fifth of it.
fn peaks(totals_n: &[f64]) -> Vec<f64> {
    let mut found = Vec::new();
    let (mut most, mut rising) = (0.0f64, true);
    let mut least = f64::INFINITY;
    for &force_n in totals_n {
        if rising {
            most = most.max(force_n);
            if most > PEAK_MIN_N && force_n < 0.8 * most {
                found.push(most);
                (rising, least) = (false, force_n);
            }
        } else {
            least = least.min(force_n);
            if force_n > PEAK_MIN_N && force_n > 1.25 * least {
                (rising, most) = (true, force_n);
            }
        }
    }
    found
}

/// Largest total force of each stretch of rows in which somebody is touched.
fn contacts(totals_n: &[f64]) -> Vec<f64> {
    let touching = |a: &f64, b: &f64| (*a > 0.0) == (*b > 0.0);
    totals_n.chunk_by(touching).map(most).filter(|force_n| *force_n > 0.0).collect()
}

fn to_f64(count: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "rows of one run")]
    let count = count as f64;
    count
}

/// Componentwise a − b.
pub fn difference(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Root of the mean square; 0 of nothing.
pub fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 }
}
