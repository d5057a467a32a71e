//! Durations of each stage of a tick, and lateness of the wake-up. Recording is bounded and does not allocate.

use crate::control::stage::{Stage, StageTimer};
use hdrhistogram::Histogram;
use moca_msgs::STAGES;
use std::fmt;
use std::time::{Duration, Instant};

/// A distribution of durations, ns.
#[derive(Clone, Debug)]
pub struct Distribution(Option<Histogram<u64>>);

impl Distribution {
    const LONGEST_NS: u64 = 60_000_000_000;

    /// Covers 1 ns to 60 s with two significant digits; longer times count as 60 s.
    ///
    /// # Errors
    /// Never for these constant bounds; the histogram library checks them at run time.
    pub fn new() -> Result<Self, hdrhistogram::CreationError> {
        Histogram::new_with_bounds(1, Self::LONGEST_NS, 2).map(Some).map(Self)
    }

    /// Stays empty and holds no memory.
    const OFF: Self = Self(None);

    /// Recorded durations, if there are any.
    fn recorded(&self) -> Option<&Histogram<u64>> {
        self.0.as_ref().filter(|durations| !durations.is_empty())
    }

    /// Adds one duration.
    pub fn record(&mut self, duration: Duration) {
        let ns = u64::try_from(duration.as_nanos()).unwrap_or(Self::LONGEST_NS);
        if let Some(durations) = &mut self.0 {
            durations.saturating_record(ns.max(1));
        }
    }

    /// Value at a quantile (0 to 1), µs; 0 when empty.
    pub fn quantile_us(&self, quantile: f64) -> f64 {
        self.recorded().map_or(0.0, |durations| micros(durations.value_at_quantile(quantile)))
    }

    /// Number of durations recorded.
    pub fn len(&self) -> u64 {
        self.recorded().map_or(0, Histogram::len)
    }

    /// Returns true if nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.recorded().is_none()
    }
}

impl fmt::Display for Distribution {
    /// `min / p50 / p99 / max`, µs.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(ns) = self.recorded() else {
            return write!(f, "{:>9} {:>9} {:>9} {:>9}", "-", "-", "-", "-");
        };
        let [min, p50, p99, max] =
            [ns.min(), ns.value_at_quantile(0.5), ns.value_at_quantile(0.99), ns.max()];
        write!(f, "{:>9.1} {:>9.1} {:>9.1} {:>9.1}", micros(min), micros(p50), micros(p99), micros(max))
    }
}

#[expect(clippy::cast_precision_loss, reason = "durations are far below 2^53 ns")]
fn micros(ns: u64) -> f64 {
    ns as f64 * 1e-3
}

/// Distributions of a whole run.
#[derive(Clone, Debug)]
pub struct Timing {
    /// Time between the starts of consecutive ticks.
    pub period: Distribution,
    /// Delay of a wake-up after its deadline.
    pub lateness: Distribution,
    /// Age of the cover's data at each tick.
    pub frame_age: Distribution,
    /// Each stage, in the order of [`Stage::ALL`].
    pub stages: [Distribution; 5],
    /// Reads no clock.
    off: bool,
    last_start: Option<Instant>,
    mark: Instant,
    slowest: (Stage, Duration),
    last_stages_ns: [u32; STAGES.len()],
}

impl Timing {
    /// Empty distributions.
    ///
    /// # Errors
    /// See [`Distribution::new`].
    pub fn new() -> Result<Self, hdrhistogram::CreationError> {
        let empty = Distribution::new()?;
        Ok(Self {
            period: empty.clone(),
            lateness: empty.clone(),
            frame_age: empty.clone(),
            stages: [empty.clone(), empty.clone(), empty.clone(), empty.clone(), empty],
            off: false,
            last_start: None,
            mark: Instant::now(),
            slowest: (Stage::Read, Duration::ZERO),
            last_stages_ns: [0; STAGES.len()],
        })
    }

    /// Without measurements and their memory: for runs that nobody asks how long their ticks took.
    pub fn off() -> Self {
        Self {
            period: Distribution::OFF,
            lateness: Distribution::OFF,
            frame_age: Distribution::OFF,
            stages: [const { Distribution::OFF }; 5],
            off: true,
            last_start: None,
            mark: Instant::now(),
            slowest: (Stage::Read, Duration::ZERO),
            last_stages_ns: [0; STAGES.len()],
        }
    }

    /// Marks the start of a tick.
    pub fn start(&mut self) {
        if self.off {
            return;
        }
        let now = Instant::now();
        if let Some(last) = self.last_start.replace(now) {
            self.period.record(now - last);
        }
        self.mark = now;
        self.slowest = (Stage::Read, Duration::ZERO);
    }

    /// Counts the age of the cover's data that a tick used, s; a negative one is none.
    pub fn count_frame_age(&mut self, age_s: f64) {
        if !self.off
            && let Ok(age) = Duration::try_from_secs_f64(age_s)
        {
            self.frame_age.record(age);
        }
    }

    /// Returns the last duration of each stage, ns; 0 for a stage that never ended.
    pub const fn last_stages_ns(&self) -> [u32; STAGES.len()] {
        self.last_stages_ns
    }

    /// The longest stage of the current tick: the one an overrun is charged to.
    pub const fn slowest(&self) -> Stage {
        self.slowest.0
    }
}

impl StageTimer for Timing {
    fn end(&mut self, stage: Stage) {
        if self.off {
            return;
        }
        let now = Instant::now();
        let took = now - self.mark;
        self.mark = now;
        self.stages[stage as usize].record(took);
        self.last_stages_ns[stage as usize] = u32::try_from(took.as_nanos()).unwrap_or(u32::MAX);
        if took > self.slowest.1 {
            self.slowest = (stage, took);
        }
    }
}

impl fmt::Display for Timing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  {:<12} {:>9} {:>9} {:>9} {:>9}", "time, µs", "min", "p50", "p99", "max")?;
        writeln!(f, "  {:<12} {}", "period", self.period)?;
        writeln!(f, "  {:<12} {}", "lateness", self.lateness)?;
        for stage in Stage::ALL {
            writeln!(f, "  {:<12} {}", stage.name(), self.stages[stage as usize])?;
        }
        Ok(())
    }
}
