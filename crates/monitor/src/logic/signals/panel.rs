//! Which signals are plotted together, with their names and units.

use crate::logic::format::taxel_name;
use moca_msgs::{Sample, TaxelStatus};
use moca_telemetry::RobotDescription;

/// One number of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// Force of a taxel, N; missing unless its status is Ok.
    Taxel(usize),
    /// Cover wrench in B: N, N, N·m.
    CoverWrench(usize),
    /// Base pose in W: m, m, rad.
    BasePose(usize),
    /// Its rate: m/s, m/s, rad/s.
    BaseVelocity(usize),
    /// Flange position in W, m.
    Flange(usize),
    /// Desired flange position in W, m.
    FlangeDesired(usize),
    /// External wrench on the robot about the flange, world axes: N, N·m.
    FlangeWrench(usize),
    /// Distance of the flange from its desired position, mm.
    FlangeErrorMm,
    /// Lateness of the loop's wake-up, µs.
    LatenessUs,
    /// Age of the cover's data, ms; missing before the first good frame.
    FrameAgeMs,
}

impl Signal {
    /// The number, NaN where there is none.
    pub fn value(self, s: &Sample) -> f64 {
        let known = |value: Option<&f64>| value.copied().unwrap_or(f64::NAN);
        match self {
            Self::Taxel(i) => match s.taxels.get(i) {
                Some(taxel) if taxel.status == TaxelStatus::Ok => taxel.force_n,
                _ => f64::NAN,
            },
            Self::CoverWrench(i) => known(s.cover_wrench_base.get(i)),
            Self::BasePose(i) => known(s.base_pose_world.get(i)),
            Self::BaseVelocity(i) => known(s.base_velocity_world.get(i)),
            Self::FlangeWrench(i) => known(s.flange_wrench_world.get(i)),
            Self::Flange(i) => known(s.flange_position_world.get(i)),
            Self::FlangeDesired(i) => known(s.flange_desired_position_world.get(i)),
            Self::FlangeErrorMm => 1e3 * s.flange_error_m(),
            Self::LatenessUs => s.lateness_s * 1e6,
            Self::FrameAgeMs if s.frame_age_s < 0.0 => f64::NAN,
            Self::FrameAgeMs => s.frame_age_s * 1e3,
        }
    }
}

impl Signal {
    /// Returns true if it is drawn dashed: a desired value next to the measured one.
    pub fn is_desired(self) -> bool {
        matches!(self, Self::FlangeDesired(_))
    }
}

/// Signals that share a plot and its unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Heading.
    pub title: &'static str,
    /// Unit of the vertical axis.
    pub unit: &'static str,
    /// Digits after the point that are worth reading.
    pub decimals: usize,
    /// Least height of the vertical axis, in its unit: noise is not blown up to fill the plot.
    pub least_span: f64,
    /// Names and signals.
    pub traces: Vec<(String, Signal)>,
}

/// The paper's plots for the parts that a robot has, in order of reading.
pub fn panels(description: &RobotDescription) -> Vec<Panel> {
    let taxels = (0..description.taxels.len()).map(|i| (taxel_name(i), Signal::Taxel(i)));
    let panel = |title, unit, decimals, least_span, traces: &[(&str, Signal)]| Panel {
        title,
        unit,
        decimals,
        least_span,
        traces: traces.iter().map(|(name, signal)| ((*name).to_owned(), *signal)).collect(),
    };
    use Signal::{BasePose, BaseVelocity, CoverWrench, Flange, FlangeDesired, FlangeErrorMm, FlangeWrench};
    let flange = [
        ("x", Flange(0)),
        ("x desired", FlangeDesired(0)),
        ("y", Flange(1)),
        ("y desired", FlangeDesired(1)),
        ("z", Flange(2)),
        ("z desired", FlangeDesired(2)),
    ];
    let force = [("fx", FlangeWrench(0)), ("fy", FlangeWrench(1)), ("fz", FlangeWrench(2))];
    let (cover, arm, base) = (description.has_cover(), description.has_arm(), description.has_base());
    let wrench = [("fx", CoverWrench(0)), ("fy", CoverWrench(1))];
    let plots = [
        (cover, Panel { traces: taxels.collect(), ..panel("Taxel forces", "N", 1, 10.0, &[]) }),
        (arm, panel("Flange, desired dashed", "m", 3, 0.02, &flange)),
        (base, panel("Base force", "N", 1, 10.0, &wrench)),
        (arm, panel("Flange from its place", "mm", 1, 10.0, &[("error", FlangeErrorMm)])),
        (base, panel("Base moment", "N·m", 1, 5.0, &[("mz", CoverWrench(2))])),
        (arm, panel("Flange force", "N", 1, 10.0, &force)),
        (base, panel("Base position", "m", 3, 0.02, &[("x", BasePose(0)), ("y", BasePose(1))])),
        (base, panel("Base velocity", "m/s", 3, 0.02, &[("x", BaseVelocity(0)), ("y", BaseVelocity(1))])),
        (base, panel("Base yaw", "rad", 3, 0.02, &[("yaw", BasePose(2))])),
        (base, panel("Base turning", "rad/s", 3, 0.02, &[("yaw rate", BaseVelocity(2))])),
    ];
    plots.into_iter().filter_map(|(has_part, panel)| has_part.then_some(panel)).collect()
}

/// The plots of how well loop and board keep time.
pub fn timing_panels() -> Vec<Panel> {
    let panel = |title, unit, least_span, name: &str, signal| Panel {
        title,
        unit,
        decimals: 0,
        least_span,
        traces: vec![(name.to_owned(), signal)],
    };
    vec![
        panel("Loop lateness", "µs", 100.0, "late", Signal::LatenessUs),
        panel("Age of cover data", "ms", 50.0, "age", Signal::FrameAgeMs),
    ]
}

/// Name of a signal as the heading of a table's column: plot, curve and unit, without a comma.
pub fn column_name<'a>(panels: impl IntoIterator<Item = &'a Panel>, signal: Signal) -> String {
    let in_panel = |panel: &Panel| {
        let (name, _) = panel.traces.iter().find(|(_, s)| *s == signal)?;
        let title = panel.title.split(',').next().unwrap_or_default();
        Some(format!("{title} {name} [{}]", panel.unit))
    };
    panels.into_iter().find_map(in_panel).unwrap_or_default()
}

/// Vertical range for values between `extremes`: at least `least_span` high, ends at round numbers.
pub fn vertical_range(extremes: Option<(f64, f64)>, least_span: f64) -> (f64, f64) {
    let (low, high) = extremes.unwrap_or((0.0, 0.0));
    let missing = (least_span - (high - low)).max(0.0);
    // A signal that never goes below zero keeps zero as its floor.
    let (low, high) = if low >= 0.0 && low < missing {
        (0.0, high.max(least_span))
    } else {
        (low - missing / 2.0, high + missing / 2.0)
    };
    let margin = 0.05 * (high - low);
    let step = round_step((high - low) / 8.0);
    let low = if low == 0.0 { 0.0 } else { ((low - margin) / step).floor() * step };
    (low, ((high + margin) / step).ceil() * step)
}

/// Round values between `low` and `high`, about `count` of them, and the step between them.
pub fn round_marks(low: f64, high: f64, count: f64) -> (Vec<f64>, f64) {
    let step = round_step((high - low) / count);
    let first = (low / step).ceil();
    let marks = (0..8).map(|i| (first + f64::from(i)) * step);
    (marks.take_while(|value| *value <= high + 1e-9 * step).collect(), step)
}

/// The nearest of 1, 2, 5 · 10ⁿ not below `step`.
fn round_step(step: f64) -> f64 {
    let decade = 10f64.powf(step.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|f| f * decade >= step);
    factor.unwrap_or(10.0) * decade
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values are copied or round, not computed")]
mod tests {
    use super::*;
    use moca_msgs::TaxelReading;

    #[test]
    fn every_axis_has_a_unit_and_every_taxel_a_trace() {
        let panels = panels(&RobotDescription::paper("test", true));
        assert!(
            panels
                .iter()
                .chain(&timing_panels())
                .all(|p| !p.unit.is_empty() && !p.traces.is_empty() && p.least_span > 0.0)
        );
        assert_eq!(panels[0].traces.len(), 11);
        assert_eq!(panels[0].traces[10], ("T11".to_owned(), Signal::Taxel(10)));
    }

    #[test]
    fn a_column_s_name_tells_plot_curve_and_unit_and_has_no_comma() {
        let panels = panels(&RobotDescription::paper("test", true));
        assert_eq!(column_name(&panels, Signal::FlangeDesired(1)), "Flange y desired [m]");
        let signals = panels.iter().flat_map(|p| &p.traces);
        assert!(signals.map(|(_, s)| column_name(&panels, *s)).all(|n| !n.is_empty() && !n.contains(',')));
    }

    #[test]
    fn a_taxel_without_a_valid_reading_is_missing_and_not_zero() {
        let mut sample = Sample::default();
        sample.taxels.push(TaxelReading { force_n: 0.0, status: TaxelStatus::Stale }).unwrap();
        sample.taxels.push(TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }).unwrap();
        assert!(Signal::Taxel(0).value(&sample).is_nan());
        assert!(Signal::Taxel(1).value(&sample) == 0.0);
        assert!(Signal::Taxel(2).value(&sample).is_nan());
        sample.frame_age_s = -1.0;
        assert!(Signal::FrameAgeMs.value(&sample).is_nan());
    }

    #[test]
    fn the_vertical_range_holds_every_value() {
        for (low, high) in
            [(0.0, 0.0), (0.0, 57.3), (-3.0, 2.0), (1.2345, 1.2346), (-1e-9, 0.0), (900.0, 1e5)]
        {
            let (bottom, top) = vertical_range(Some((low, high)), 10.0);
            assert!(
                bottom <= low && high <= top && top - bottom >= 10.0 - 1e-9,
                "{low}..{high}: {bottom}..{top}"
            );
        }
        assert_eq!(vertical_range(None, 10.0).0, 0.0);
    }

    #[test]
    fn marks_are_round_and_never_too_many() {
        assert_eq!(round_marks(-10.0, 0.0, 5.0), (vec![-10.0, -8.0, -6.0, -4.0, -2.0, 0.0], 2.0));
        assert_eq!(round_marks(0.0, 16.0, 5.0), (vec![0.0, 5.0, 10.0, 15.0], 5.0));
        assert_eq!(round_marks(-60.0, 0.0, 5.0).1, 20.0);
        for span in [1e-3, 0.3, 7.0, 99.0, 12345.0] {
            let (marks, _) = round_marks(-0.3 * span, span, 5.0);
            assert!((2..=7).contains(&marks.len()), "{marks:?}");
        }
    }
}
