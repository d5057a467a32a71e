//! A whole run at a glance: the largest values of each second, and marks for what happened. A finished log ends with it,
//! so that a day opens without reading the day.
//!
//! ```
//! use moca_msgs::Sample;
//! use moca_telemetry::log::overview::OverviewBuilder;
//! let mut builder = OverviewBuilder::default();
//! for tick in 0..3000 {
//!     let lateness_s = if tick == 1500 { 2e-3 } else { 1e-5 };
//!     builder.add(&Sample { tick, time_ns: tick * 1_000_000, lateness_s, ..Sample::default() });
//! }
//! let overview = builder.finish();
//! assert_eq!(overview.spans.len(), 3);
//! assert_eq!(overview.spans[1].lateness_s, 2e-3);
//! ```

use moca_msgs::{Fault, Mode, Sample, TaxelStatus, protection::ContactPhase};
use serde::{Deserialize, Serialize};

/// Most spans; beyond them neighbours are put together, so that a log of any length has a bounded overview.
const MAX_SPANS: usize = 1 << 15;
/// Most marks; later ones are counted only.
const MAX_MARKS: usize = 1 << 14;

/// A run at a glance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Overview {
    /// Length of each span, ns of loop time: a second, or more in a long run.
    pub span_ns: u64,
    /// Summary of each span, in order; spans without a sample are left out.
    pub spans: Vec<Span>,
    /// Events at single instants, in order.
    pub marks: Vec<Mark>,
    /// Marks that found no room.
    pub marks_dropped: u64,
}

/// The largest values of a span of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Span {
    /// Its beginning, ns of loop time.
    pub start_ns: u64,
    /// Largest force of a healthy taxel, N.
    pub force_n: f32,
    /// Largest speed of the cover's fastest point, m/s.
    pub cover_speed_m_s: f32,
    /// Largest distance between flange and desired flange, m.
    pub flange_error_m: f32,
    /// Latest wake-up, s.
    pub lateness_s: f32,
    /// Oldest data of the cover, s.
    pub frame_age_s: f32,
}

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// When, ns of loop time.
    pub time_ns: u64,
    /// Event.
    pub what: Happening,
}

/// Event that a mark stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Happening {
    /// A hand on an untouched cover.
    Touch,
    /// A contact crossed a limit.
    LimitCrossed,
    /// Another mode.
    Mode(Mode),
    /// A fault came up.
    Fault(Fault),
}

impl Default for Overview {
    fn default() -> Self {
        Self { span_ns: 1_000_000_000, spans: Vec::new(), marks: Vec::new(), marks_dropped: 0 }
    }
}

impl Overview {
    /// First and last instant, ns of loop time; the last to the span.
    pub fn range_ns(&self) -> Option<(u64, u64)> {
        Some((self.spans.first()?.start_ns, self.spans.last()?.start_ns + self.span_ns))
    }

    fn add(&mut self, sample: &Sample) {
        let start_ns = sample.time_ns - sample.time_ns % self.span_ns;
        let here = Span::of(sample, start_ns);
        match self.spans.last_mut() {
            Some(last) if last.start_ns >= start_ns => last.join(&here),
            _ => self.spans.push(here),
        }
        if self.spans.len() > MAX_SPANS {
            self.halve();
        }
    }

    fn halve(&mut self) {
        self.span_ns *= 2;
        let span_ns = self.span_ns;
        let mut joined: Vec<Span> = Vec::with_capacity(MAX_SPANS);
        for mut span in self.spans.drain(..) {
            span.start_ns -= span.start_ns % span_ns;
            match joined.last_mut() {
                Some(last) if last.start_ns == span.start_ns => last.join(&span),
                _ => joined.push(span),
            }
        }
        self.spans = joined;
    }

    fn mark(&mut self, time_ns: u64, what: Happening) {
        if self.marks.len() < MAX_MARKS {
            self.marks.push(Mark { time_ns, what });
        } else {
            self.marks_dropped += 1;
        }
    }
}

impl Span {
    fn of(sample: &Sample, start_ns: u64) -> Self {
        let healthy = sample.taxels.iter().filter(|taxel| taxel.status == TaxelStatus::Ok);
        let error_m = if sample.q_rad.is_empty() { 0.0 } else { sample.flange_error_m() };
        Self {
            start_ns,
            force_n: single(healthy.map(|taxel| taxel.force_n).fold(0.0, f64::max)),
            cover_speed_m_s: single(sample.cover_speed_m_s),
            flange_error_m: single(error_m),
            lateness_s: single(sample.lateness_s),
            frame_age_s: single(sample.frame_age_s),
        }
    }

    fn join(&mut self, other: &Self) {
        self.force_n = self.force_n.max(other.force_n);
        self.cover_speed_m_s = self.cover_speed_m_s.max(other.cover_speed_m_s);
        self.flange_error_m = self.flange_error_m.max(other.flange_error_m);
        self.lateness_s = self.lateness_s.max(other.lateness_s);
        self.frame_age_s = self.frame_age_s.max(other.frame_age_s);
    }
}

/// For a picture; what is not finite is not drawn.
#[expect(clippy::cast_possible_truncation, reason = "to the nearest single")]
fn single(value: f64) -> f32 {
    if value.is_finite() { value as f32 } else { 0.0 }
}

/// Builds an overview sample by sample.
#[derive(Clone, Debug, Default)]
pub struct OverviewBuilder {
    overview: Overview,
    last: Option<(Mode, Option<Fault>, bool)>,
}

impl OverviewBuilder {
    /// Adds the next sample.
    pub fn add(&mut self, sample: &Sample) {
        let touched = sample.taxels.iter().any(|t| t.status == TaxelStatus::Ok && t.force_n > 0.0);
        let last = self.last.replace((sample.mode, sample.fault, touched));
        let overview = &mut self.overview;
        if last.is_none_or(|(mode, ..)| mode != sample.mode) {
            overview.mark(sample.time_ns, Happening::Mode(sample.mode));
        }
        if let Some(fault) = sample.fault
            && last.and_then(|(_, fault, _)| fault) != Some(fault)
        {
            overview.mark(sample.time_ns, Happening::Fault(fault));
        }
        if touched && last.is_some_and(|(.., touched)| !touched) {
            overview.mark(sample.time_ns, Happening::Touch);
        }
        if sample.contact_events.iter().any(|event| event.phase == ContactPhase::LimitCrossed) {
            overview.mark(sample.time_ns, Happening::LimitCrossed);
        }
        overview.add(sample);
    }

    /// The overview so far.
    pub const fn overview(&self) -> &Overview {
        &self.overview
    }

    /// The overview.
    pub fn finish(self) -> Overview {
        self.overview
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::TaxelReading;

    fn sample(second: u64, force_n: f64) -> Sample {
        let mut sample = Sample { tick: second, time_ns: second * 1_000_000_000, ..Sample::default() };
        sample.taxels.push(TaxelReading { force_n, status: TaxelStatus::Ok }).unwrap();
        sample
    }

    #[test]
    fn a_run_of_any_length_keeps_its_worst_and_a_bounded_size() {
        let mut builder = OverviewBuilder::default();
        for second in 0..200_000 {
            builder.add(&sample(second, if second == 123_456 { 77.0 } else { 0.0 }));
        }
        let overview = builder.finish();
        assert!(overview.spans.len() <= MAX_SPANS && overview.span_ns == 8_000_000_000);
        let most_n = overview.spans.iter().map(|span| span.force_n).fold(0.0, f32::max);
        assert_eq!(most_n.to_bits(), 77.0_f32.to_bits());
        assert_eq!(overview.range_ns(), Some((0, 200_000_000_000_000)));
        let touch = Mark { time_ns: 123_456_000_000_000, what: Happening::Touch };
        assert!(overview.marks.contains(&touch));
    }
}
