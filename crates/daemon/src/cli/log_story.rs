//! Story of a run in words.

use moca_msgs::seconds;
use moca_telemetry::log::story::{LISTED, Requests, Stop, Story, Touch};
use std::fmt;
use std::time::{Duration, UNIX_EPOCH};

/// `2026-11-25 12:03:04 UTC`: an instant of loop time, of a run whose time 0 is given.
pub(super) fn clock(start_unix_ns: u64, time_ns: u64) -> String {
    let at = UNIX_EPOCH + Duration::from_nanos(start_unix_ns.saturating_add(time_ns));
    let stamp = humantime::format_rfc3339_seconds(at).to_string();
    format!("{} UTC", stamp.trim_end_matches('Z').replace('T', " "))
}

/// A story in words.
pub(super) struct Told<'a> {
    /// The story.
    pub(super) story: &'a Story,
    /// Unix time of loop time 0, ns.
    pub(super) start_unix_ns: u64,
}

impl fmt::Display for Told<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { story, start_unix_ns } = *self;
        writeln!(f, "  stops        {}", story.stop_count)?;
        for Stop { begin_ns, end_ns, mode, fault } in &story.stops {
            let lasted = end_ns.map_or_else(
                || "until the end".to_owned(),
                |end_ns| format!("for {:.1} s", seconds(end_ns.saturating_sub(*begin_ns))),
            );
            let why = fault.map_or_else(String::new, |fault| format!("{}: {fault}", fault.code()));
            let (at_s, at) = (seconds(*begin_ns), clock(start_unix_ns, *begin_ns));
            writeln!(f, "    {at_s:9.2} s  {at}  {} {lasted}  {why}", mode.name())?;
        }
        match story.stop_count.saturating_sub(story.stops.len() as u64) {
            0 => {}
            more => writeln!(f, "    and {more} more")?,
        }
        write!(f, "  touches      {}", story.touches)?;
        if let Some(Touch { taxel, force_n, time_ns }) = story.largest {
            write!(f, ", the largest {force_n:.1} N on T{} at {:.2} s", taxel + 1, seconds(time_ns))?;
            let began = story.of_taxel.iter().enumerate().filter(|(_, count)| **count > 0);
            let where_: Vec<String> = began.map(|(taxel, count)| format!("T{} {count}", taxel + 1)).collect();
            write!(f, "; began on {}", where_.join(", "))?;
        }
        writeln!(f, "\n  limits       {} contacts crossed one", story.limits)?;
        match story.gap_count {
            (0, _) => write!(f, "  gaps         none")?,
            (count, lost_ns) => {
                write!(f, "  gaps         {count}, {:.2} s in all:", seconds(lost_ns))?;
                for (from_ns, to_ns) in &story.gaps {
                    write!(f, " {:.2} to {:.2} s;", seconds(*from_ns), seconds(*to_ns))?;
                }
            }
        }
        let missed = story.overruns.map_or(0, |(first, last)| last.saturating_sub(first));
        writeln!(f, "; {missed} ticks of the loop were missed")?;
        for (number, (who, requests)) in story.asked.iter().take(LISTED).enumerate() {
            let title = if number == 0 { "asked by" } else { "" };
            let Requests { accepted, refused } = requests;
            writeln!(f, "  {title:12} {who}: {accepted} carried out, {refused} refused")?;
        }
        match story.asked.len().saturating_sub(LISTED) {
            0 => Ok(()),
            more => writeln!(f, "    and {more} more"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{BoardFault, Fault, Mode, Sample, TaxelReading, TaxelStatus};
    use moca_telemetry::audit::Asked;

    /// A sample each 20 ms with these forces.
    fn told(each: impl Iterator<Item = (u64, Mode, Option<Fault>, [f64; 2])>) -> String {
        let mut story = Story::default();
        for (shown, mode, fault, forces_n) in each {
            let mut sample = Sample { time_ns: shown * 20_000_000, mode, fault, ..Sample::default() };
            let taxels = forces_n.map(|force_n| TaxelReading { force_n, status: TaxelStatus::Ok });
            sample.taxels.extend(taxels);
            story.add(&sample);
        }
        Told { story: &story, start_unix_ns: 1_764_072_184_000_000_000 }.to_string()
    }

    #[test]
    fn stops_are_told_with_time_cause_and_remedy() {
        let told = told((0..500).map(|shown| match shown {
            100..200 => (shown, Mode::ProtectiveStop, Some(BoardFault::Lost.of(0)), [0.0; 2]),
            400.. => (shown, Mode::ProtectiveStop, Some(Fault::OperatorStop), [0.0; 2]),
            _ => (shown, Mode::Impedance, None, [0.0; 2]),
        }));
        assert!(told.contains("stops        2"), "{told}");
        let first = "2.00 s  2025-11-25 12:03:06 UTC  protective stop for 2.0 s  board-lost:";
        assert!(told.contains(first) && told.contains(BoardFault::Lost.of(0).remedy()), "{told}");
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
        let told = Told { story: &story, start_unix_ns: 0 }.to_string();
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
