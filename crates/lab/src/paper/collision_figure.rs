//! Figure of the collision.

use super::figure::{self, Figure, Trace};
use super::robot_picture::Moment;
use moca_experiments::closed_loop::Row;
use moca_experiments::collision::Run;
use moca_sim::Scene;

/// Fig. 7; `moments` are those of the run.
pub(crate) fn figure<'a>(run: &'a Run, moments: &'a [Moment], scene: &'a Scene) -> Figure<'a> {
    let trace = Trace { rows: &run.rows, others: &run.others };
    Figure {
        scene,
        trace,
        moments,
        panels: figure::panels(figure::lead(trace), trace),
        another: "phase of the sensor",
        stopped: run.report.stopped(),
    }
}

/// The arm leads; first contact; the first peak; the base has resumed.
pub(crate) fn moments(rows: &[Row]) -> Vec<Moment> {
    let last = rows.len().saturating_sub(1);
    let touching = |row: &Row| row.total_force_n > 0.0;
    let contact = rows.iter().position(touching).unwrap_or(last);
    let end = rows.iter().rposition(touching).unwrap_or(last);
    let peak = (contact..=end.min(last))
        .max_by(|&a, &b| rows[a].total_force_n.total_cmp(&rows[b].total_force_n))
        .unwrap_or(last);
    [
        ("arm leads", last.min(500)),
        ("contact", contact),
        ("largest force", peak),
        ("base resumes", last.min(end + 1000)),
    ]
    .map(|(name, row)| Moment { name: name.to_owned(), row })
    .to_vec()
}
