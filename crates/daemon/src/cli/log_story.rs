//! Story of a run, told from its samples: stops, touches, limits, gaps.

use moca_msgs::protection::ContactPhase;
use moca_msgs::{Mode, Sample, TaxelStatus, seconds};
use moca_telemetry::audit::Asked;
use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, UNIX_EPOCH};

/// A longer time without a sample is a gap, ns: a log shows a sample each 20 ms.
const GAP_NS: u64 = 100_000_000;
/// Stops, and gaps, that are listed; the others are counted.
const LISTED: usize = 20;

/// `2026-11-25 12:03:04 UTC`: an instant of loop time, of a run whose time 0 is given.
pub(super) fn clock(start_unix_ns: u64, time_ns: u64) -> String {
    let at = UNIX_EPOCH + Duration::from_nanos(start_unix_ns.saturating_add(time_ns));
    let stamp = humantime::format_rfc3339_seconds(at).to_string();
    format!("{} UTC", stamp.trim_end_matches('Z').replace('T', " "))
}

/// A stop: when it began, for how long as far as is known, and why.
#[derive(Debug)]
struct Stop {
    begin_ns: u64,
    end_ns: Option<u64>,
    mode: Mode,
    why: String,
}

/// A touch of one taxel at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Touch {
    taxel: usize,
    force_n: f64,
    time_ns: u64,
}

/// A run as it is told.
#[derive(Debug, Default)]
pub(super) struct Story {
    start_unix_ns: u64,
    stops: Vec<Stop>,
    last: Option<(u64, Mode)>,
    touched: bool,
    touches: u64,
    largest: Option<Touch>,
    /// Touches that began at each taxel.
    of_taxel: Vec<u64>,
    limits: u64,
    gaps: Vec<(u64, u64)>,
    overruns: Option<(u64, u64)>,
    /// Requests of each client: carried out, refused.
    asked: BTreeMap<String, (u64, u64)>,
}

impl Story {
    /// A run whose loop time 0 is this Unix time, ns.
    pub(super) fn new(start_unix_ns: u64) -> Self {
        Self { start_unix_ns, ..Self::default() }
    }

    /// No sample has been added.
    pub(super) const fn is_empty(&self) -> bool {
        self.last.is_none()
    }

    /// Adds the next sample.
    pub(super) fn add(&mut self, sample: &Sample) {
        let before = self.last.replace((sample.time_ns, sample.mode));
        if let Some((last_ns, _)) = before
            && sample.time_ns.saturating_sub(last_ns) > GAP_NS
        {
            self.gaps.push((last_ns, sample.time_ns));
        }
        self.stop(before.map(|(_, mode)| mode), sample);
        self.touch(sample);
        let crossed = |phase| phase == ContactPhase::LimitCrossed;
        self.limits +=
            sample.contact_events.iter().filter(|event| crossed(event.phase)).map(|_| 1).sum::<u64>();
        let first = self.overruns.map_or(sample.overruns, |(first, _)| first);
        self.overruns = Some((first, sample.overruns));
    }

    /// Adds requests of a client.
    pub(super) fn asked(&mut self, asked: &Asked) {
        if !asked.is_request() {
            return;
        }
        let (accepted, refused) = self.asked.entry(asked.who.clone()).or_default();
        *if asked.accepted { accepted } else { refused } += asked.times;
    }

    fn stop(&mut self, before: Option<Mode>, sample: &Sample) {
        let stopped = |mode: Mode| matches!(mode, Mode::ProtectiveStop | Mode::Fault);
        if before == Some(sample.mode) {
            return;
        }
        if let Some(open) = self.stops.last_mut().filter(|stop| stop.end_ns.is_none()) {
            open.end_ns = Some(sample.time_ns);
        }
        if stopped(sample.mode) {
            let why = sample.fault.map_or_else(String::new, |fault| format!("{}: {fault}", fault.code()));
            let (begin_ns, mode) = (sample.time_ns, sample.mode);
            self.stops.push(Stop { begin_ns, end_ns: None, mode, why });
        }
    }

    fn touch(&mut self, sample: &Sample) {
        let healthy = sample.taxels.iter().enumerate().filter(|(_, taxel)| taxel.status == TaxelStatus::Ok);
        let strongest = healthy
            .filter(|(_, taxel)| taxel.force_n > 0.0)
            .max_by(|a, b| a.1.force_n.total_cmp(&b.1.force_n))
            .map(|(taxel, reading)| Touch { taxel, force_n: reading.force_n, time_ns: sample.time_ns });
        let begins = strongest.filter(|_| !self.touched);
        self.touched = strongest.is_some();
        if let Some(Touch { taxel, .. }) = begins {
            self.touches += 1;
            self.of_taxel.resize(self.of_taxel.len().max(taxel + 1), 0);
            self.of_taxel[taxel] += 1;
        }
        let largest_n = self.largest.map_or(0.0, |largest| largest.force_n);
        self.largest = strongest.filter(|touch| touch.force_n > largest_n).or(self.largest);
    }
}

impl fmt::Display for Story {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  stops        {}", self.stops.len())?;
        for stop in self.stops.iter().take(LISTED) {
            let lasted = stop.end_ns.map_or_else(
                || "until the end".to_owned(),
                |end_ns| format!("for {:.1} s", seconds(end_ns.saturating_sub(stop.begin_ns))),
            );
            let (at_s, at) = (seconds(stop.begin_ns), clock(self.start_unix_ns, stop.begin_ns));
            writeln!(f, "    {at_s:9.2} s  {at}  {} {lasted}  {}", stop.mode.name(), stop.why)?;
        }
        if self.stops.len() > LISTED {
            writeln!(f, "    and {} more", self.stops.len() - LISTED)?;
        }
        write!(f, "  touches      {}", self.touches)?;
        if let Some(Touch { taxel, force_n, time_ns }) = self.largest {
            write!(f, ", the largest {force_n:.1} N on T{} at {:.2} s", taxel + 1, seconds(time_ns))?;
            let began = self.of_taxel.iter().enumerate().filter(|(_, count)| **count > 0);
            let where_: Vec<String> = began.map(|(taxel, count)| format!("T{} {count}", taxel + 1)).collect();
            write!(f, "; began on {}", where_.join(", "))?;
        }
        writeln!(f, "\n  limits       {} contacts crossed one", self.limits)?;
        let lost_ns: u64 = self.gaps.iter().map(|(from, to)| to - from).sum();
        match self.gaps.as_slice() {
            [] => write!(f, "  gaps         none")?,
            gaps => {
                write!(f, "  gaps         {}, {:.2} s in all:", gaps.len(), seconds(lost_ns))?;
                for (from_ns, to_ns) in gaps.iter().take(LISTED) {
                    write!(f, " {:.2} to {:.2} s;", seconds(*from_ns), seconds(*to_ns))?;
                }
            }
        }
        let missed = self.overruns.map_or(0, |(first, last)| last.saturating_sub(first));
        writeln!(f, "; {missed} ticks of the loop were missed")?;
        for (number, (who, (accepted, refused))) in self.asked.iter().take(LISTED).enumerate() {
            let title = if number == 0 { "asked by" } else { "" };
            writeln!(f, "  {title:12} {who}: {accepted} carried out, {refused} refused")?;
        }
        match self.asked.len().saturating_sub(LISTED) {
            0 => Ok(()),
            more => writeln!(f, "    and {more} more"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{Fault, TaxelReading};

    /// A sample each 20 ms with these forces.
    fn told(each: impl Iterator<Item = (u64, Mode, Option<Fault>, [f64; 2])>) -> String {
        let mut story = Story::new(1_764_072_184_000_000_000);
        for (shown, mode, fault, forces_n) in each {
            let mut sample = Sample { time_ns: shown * 20_000_000, mode, fault, ..Sample::default() };
            let taxels = forces_n.map(|force_n| TaxelReading { force_n, status: TaxelStatus::Ok });
            sample.taxels.extend(taxels);
            story.add(&sample);
        }
        story.to_string()
    }

    #[test]
    fn stops_are_told_with_time_cause_and_remedy() {
        let told = told((0..500).map(|shown| match shown {
            100..200 => (shown, Mode::ProtectiveStop, Some(Fault::BoardLost), [0.0; 2]),
            400.. => (shown, Mode::ProtectiveStop, Some(Fault::OperatorStop), [0.0; 2]),
            _ => (shown, Mode::Impedance, None, [0.0; 2]),
        }));
        assert!(told.contains("stops        2"), "{told}");
        let first = "2.00 s  2025-11-25 12:03:06 UTC  protective stop for 2.0 s  board-lost:";
        assert!(told.contains(first) && told.contains(Fault::BoardLost.remedy()), "{told}");
        assert!(told.contains("protective stop until the end  operator-stop:"), "{told}");
        assert!(told.contains("touches      0\n") && told.contains("gaps         none"), "{told}");
    }

    #[test]
    fn touches_are_told_with_count_largest_and_place() {
        let told = told((0..500).map(|shown| match shown {
            100..110 => (shown, Mode::Impedance, None, [12.0, 3.0]),
            200..210 => (shown, Mode::Impedance, None, [0.0, 34.25]),
            300..310 => (shown, Mode::Impedance, None, [0.0, 5.0]),
            _ => (shown, Mode::Impedance, None, [0.0; 2]),
        }));
        let expected = "touches      3, the largest 34.2 N on T2 at 4.00 s; began on T1 1, T2 2\n";
        assert!(told.contains(expected), "{told}");
    }

    #[test]
    fn requests_are_counted_for_each_client() {
        let mut story = Story::default();
        for (who, accepted, times) in
            [("user 1000", true, 2), ("user 1000", false, 3), ("machine 10.0.0.7", false, 1)]
        {
            let (what, answer) = ("arm".into(), String::new());
            story.asked(&Asked { who: who.into(), what, accepted, answer, times });
        }
        let told = story.to_string();
        assert!(told.contains("user 1000: 2 carried out, 3 refused"), "{told}");
        assert!(told.contains("asked by     machine 10.0.0.7: 0 carried out, 1 refused"), "{told}");
    }

    #[test]
    fn gaps_are_told_with_their_ends() {
        let told = told(
            (0..500)
                .filter(|shown| !(100..150).contains(shown))
                .map(|shown| (shown, Mode::Ready, None, [0.0; 2])),
        );
        assert!(told.contains("gaps         1, 1.02 s in all: 1.98 to 3.00 s;"), "{told}");
    }
}
