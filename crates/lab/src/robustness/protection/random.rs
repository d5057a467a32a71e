//! Summary of a campaign of meetings drawn at random.

use super::table::{Entry, limit_n};
use moca_experiments::drawn::pick;
use moca_experiments::meeting;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The campaign that the documents hold: `--out` goes on with it.
pub(super) const CAMPAIGN: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/data/protection-drawn.csv");

/// Summary of a campaign's file.
pub(super) fn markdown(entries: &[Entry<'_>]) -> String {
    let mut parts = vec![classes(entries), cells(entries)];
    parts.extend(failures(entries));
    parts.join("\n")
}

/// Kinds of meetings, as the bars are set for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Class {
    /// The robot is led, or led by hand, into somebody who stands.
    Driven,
    /// Somebody walks, and some law could keep the force below the limit.
    Within,
    /// Somebody walks, and none could.
    Beyond,
}

impl Class {
    fn of(entry: &Entry<'_>) -> Self {
        if entry.number("person.walk") <= 0.0 {
            Self::Driven
        } else if entry.number("least_n") <= limit_n() {
            Self::Within
        } else {
            Self::Beyond
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Driven => "stands",
            Self::Within => "walks, within the bound of any law",
            Self::Beyond => "walks, beyond it",
        }
    }
}

/// Force over the least that any law leaves, or over the limit where that is more, N.
fn excess_n(entry: &Entry<'_>) -> f64 {
    entry.number("peak_n") - limit_n().max(entry.number("least_n"))
}

/// A later tap above the limit, harder than the first.
fn grows(entry: &Entry<'_>) -> bool {
    let later_n = entry.number("later_n");
    later_n > limit_n() && meeting::grows(entry.number("first_peak_n"), later_n)
}

fn classes(entries: &[Entry<'_>]) -> String {
    let mut out = format!(
        "| who moves | the person | plates | runs | met | above {0:.0} N | worst | over any law by at most | growing taps above {0:.0} N | flange | stops |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n",
        limit_n()
    );
    for meeting in ["led", "by hand", "walks"] {
        for class in [Class::Driven, Class::Within, Class::Beyond] {
            for plates in ["1", "2", "3"] {
                let of = |entry: &&Entry<'_>| {
                    entry.text("meeting") == meeting
                        && entry.text("person.plates") == plates
                        && Class::of(entry) == class
                };
                let group: Vec<&Entry<'_>> = entries.iter().filter(of).collect();
                if group.is_empty() {
                    continue;
                }
                // Writing to a string cannot fail.
                let _ = writeln!(out, "| {meeting} | {} | {plates} | {}", class.name(), line(&group));
            }
        }
    }
    out
}

fn line(group: &[&Entry<'_>]) -> String {
    let most = |value: &dyn Fn(&Entry<'_>) -> f64| group.iter().map(|entry| value(entry)).fold(0.0, f64::max);
    let count = |counts: &dyn Fn(&Entry<'_>) -> bool| group.iter().filter(|entry| counts(entry)).count();
    let mut stops = BTreeMap::<&str, usize>::new();
    for entry in group.iter().filter(|entry| !entry.text("stopped").is_empty()) {
        *stops.entry(entry.text("stopped")).or_default() += 1;
    }
    let stops: Vec<String> = stops.iter().map(|(why, count)| format!("{count} {why}")).collect();
    format!(
        "{} | {} | {} | {:.1} N | {:.1} N | {} | {:.1} mm | {} |",
        group.len(),
        count(&|entry: &Entry<'_>| entry.met()),
        count(&|entry: &Entry<'_>| entry.above()),
        most(&|entry: &Entry<'_>| entry.number("peak_n")),
        most(&|entry: &Entry<'_>| excess_n(entry)),
        count(&|entry: &Entry<'_>| grows(entry)),
        most(&|entry: &Entry<'_>| entry.number("flange_mm")),
        if stops.is_empty() { "–".to_owned() } else { stops.join(", ") }
    )
}

/// Ends of the bands of walking speeds, m/s.
const WALKS_M_S: [f64; 4] = [0.0, 0.03, 0.06, 0.1];

/// Force over the best of all laws, by board and walking speed.
fn cells(entries: &[Entry<'_>]) -> String {
    let mut out = String::from(
        "| board | walks, m/s | runs | within the bound of any law | over it by, in half the runs | in nine of ten | at most |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for board in ["moca", "stock-2018", "stock-2015"] {
        for band in WALKS_M_S.windows(2) {
            let of = |entry: &&Entry<'_>| {
                let walk_m_s = entry.number("person.walk");
                entry.text("sensor.firmware") == board
                    && walk_m_s > band[0]
                    && walk_m_s <= band[1]
                    && entry.met()
            };
            let group: Vec<&Entry<'_>> = entries.iter().filter(of).collect();
            if group.is_empty() {
                continue;
            }
            let within = group.iter().filter(|entry| Class::of(entry) == Class::Within).count();
            let mut excesses_n: Vec<f64> = group.iter().map(|entry| excess_n(entry).max(0.0)).collect();
            excesses_n.sort_unstable_by(f64::total_cmp);
            let [half, most, all] = [0.5, 0.9, 1.0].map(|share| excesses_n[pick(share, excesses_n.len())]);
            let _ = writeln!(
                out,
                "| {board} | {} to {} | {} | {within} | {half:.1} N | {most:.1} N | {all:.1} N |",
                band[0],
                band[1],
                group.len()
            );
        }
    }
    out
}

/// Every meeting that should have stayed under the limit and did not, with the reason; `None` without one.
fn failures(entries: &[Entry<'_>]) -> Option<String> {
    let is_failure = |entry: &&Entry<'_>| entry.above() && Class::of(entry) != Class::Beyond;
    let mut failed = entries.iter().filter(is_failure).peekable();
    failed.peek()?;
    let mut out =
        String::from("| run | force | of any law at least | met at | why |\n|---|---|---|---|---|\n");
    for entry in failed {
        let [peak_n, least_n, met_m_s] = ["peak_n", "least_n", "approach_m_s"].map(|name| entry.number(name));
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "| {} | {peak_n:.1} N | {least_n:.1} N | {met_m_s:.3} m/s | {} |",
            entry.text("run"),
            why(entry)
        );
    }
    Some(out)
}

/// Reason of a force above the limit that some law would have kept below it.
fn why(entry: &Entry<'_>) -> &'static str {
    if Class::of(entry) == Class::Driven && entry.number("approach_m_s") > 1.02 * entry.number("limit_m_s") {
        "met faster than the speed limit"
    } else if entry.number("peak_n") > entry.number("first_peak_n") {
        "a later tap: who walks on comes again to foam that has not recovered, and is felt later"
    } else {
        "the first tap: from the first alarm on all axes together would have made room sooner"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robustness::protection::table;
    use moca_experiments::campaign::Table as _;
    use moca_experiments::drawn::Meetings;
    use moca_experiments::parallel;

    /// Meetings of a seed that the law was not shaped on.
    const HELD_OUT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/data/protection-held-out.csv");

    /// Those of the documents' file, by its seed.
    const MEETINGS: Meetings = Meetings { runs: 200, seed: 1 };

    /// Flange error of a robot that is led, by its arm's limits and by a hand, mm.
    const FLANGE_MAX_MM: f64 = 40.0;

    #[test]
    fn drawn_meetings_keep_people_below_the_limit() {
        let ids: Vec<usize> = (0..200).collect();
        let rows = parallel::run("random", &ids, |id| MEETINGS.row(*id)).unwrap();
        let text = format!("{}\n{}\n", MEETINGS.header(), rows.join("\n"));
        table::entries(&text, |entries| {
            let mut within = 0;
            for (entry, row) in entries.iter().zip(&rows) {
                let name = format!("run {}: {row}", entry.text("run"));
                assert!(entry.number("flange_mm") <= FLANGE_MAX_MM, "{name}");
                match Class::of(entry) {
                    Class::Driven => assert!(!entry.above() && !grows(entry), "{name}"),
                    Class::Within => {
                        assert!(!entry.above(), "{name}");
                        within += 1;
                    }
                    Class::Beyond => {}
                }
            }
            assert!(within >= 20, "{within}");
            println!("{}", markdown(entries));
        })
        .unwrap();
    }

    #[test]
    fn first_meetings_match_their_files() {
        if crate::docs::shown("protection-random").is_none() {
            return; // where sines are rounded in another way, last digits are others
        }
        for (file, seed) in [(CAMPAIGN, MEETINGS.seed), (HELD_OUT, 31337)] {
            let text = std::fs::read_to_string(file).unwrap();
            for id in [0, 1, 2, 5] {
                let fresh = Meetings { seed, ..MEETINGS }.row(id).unwrap();
                assert!(text.lines().any(|line| line == fresh), "{file}: {fresh}");
            }
        }
    }

    #[test]
    fn held_out_walkers_receive_what_the_documents_say() {
        let said = include_str!("../../../../../docs/results.md");
        let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
        table::entries(&std::fs::read_to_string(HELD_OUT).unwrap(), |entries| {
            let of = |class| entries.iter().filter(move |entry| Class::of(entry) == class && entry.met());
            let most = |class| of(class).map(|entry| entry.number("peak_n")).fold(0.0, f64::max);
            for words in [
                format!("`--random {} --seed 31337`", entries.len()),
                format!("Of its {} walkers within the bound", of(Class::Within).count()),
                format!("{} receive more than 25 N", of(Class::Within).filter(|entry| entry.above()).count()),
                format!("25 N, {:.1} N at most. Who stands", most(Class::Within)),
                format!("Who stands receives {:.1} N at most.", most(Class::Driven)),
            ] {
                assert!(said.contains(&words), "{words}");
            }
        })
        .unwrap();
    }
}
