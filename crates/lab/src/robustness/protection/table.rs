//! Summary of a scan's file: shares above the limit, and the reasons.

use anyhow::{Context, Result, ensure};
use moca_control::config::ProtectionConfig;
use moca_experiments::meeting;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// A line of the file by the names of its columns.
pub(super) struct Entry<'a> {
    header: &'a [&'a str],
    values: Vec<&'a str>,
}

impl Entry<'_> {
    pub(super) fn text(&self, name: &str) -> &str {
        let column = self.header.iter().position(|column| *column == name);
        column.and_then(|column| self.values.get(column)).copied().unwrap_or("")
    }

    pub(super) fn number(&self, name: &str) -> f64 {
        self.text(name).parse().unwrap_or(f64::NAN)
    }

    pub(super) fn met(&self) -> bool {
        self.number("peak_n") > 0.0
    }

    pub(super) fn above(&self) -> bool {
        self.number("peak_n") > limit_n()
    }

    /// Why the force went beyond the limit.
    fn reason(&self) -> &'static str {
        if self.text("meeting") == "leans" {
            return "the person's own: leans with more";
        }
        if self.text("meeting") == "walks" && self.text("place") == "T2 and T9" {
            return "two walk in from both sides: there is no way out";
        }
        let within = self.number("impact_n") <= limit_n();
        if self.text("law") == "speed-limit" {
            return if within {
                "the admittance alone rings or goes on pushing after the impact"
            } else if self.number("peak_after_s") > 0.1 {
                "the admittance alone: no row stops it, and the reading is too late for its gain"
            } else {
                "the impact itself"
            };
        }
        if self.number("approach_m_s") > 1.02 * self.number("speed_m_s") {
            return "met faster than the cell's speed: the base turned into the person";
        }
        if self.number("least_n") > limit_n() {
            return "physics: felt so late that the hardest braking from then on leaves more";
        }
        if within {
            "a later contact is harder than the first"
        } else {
            "the law: braking could have kept it"
        }
    }

    /// The cell and what came of it.
    fn described(&self) -> String {
        let text = |name| self.text(name).to_owned();
        let stiffer = if text("foam") == "1" { String::new() } else { format!(", foam × {}", text("foam")) };
        let truth = if text("truth") == DESCRIBED { String::new() } else { format!(", {}", text("truth")) };
        format!(
            "{}, {}, {}, {}{stiffer}, {} of the bound{truth}",
            text("place"),
            text("meeting"),
            text("board"),
            text("person"),
            text("share")
        )
    }
}

/// Name of a robot that is as it is believed to be.
const DESCRIBED: &str = "as described";

pub(super) fn limit_n() -> f64 {
    ProtectionConfig::default().force_limit_n
}

pub(super) fn entries<R>(text: &str, use_them: impl FnOnce(&[Entry<'_>]) -> R) -> Result<R> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().context("the file is empty")?.split(',').collect();
    let entries: Vec<Entry<'_>> =
        lines.map(|line| Entry { header: &header, values: line.split(',').collect() }).collect();
    ensure!(entries.iter().all(|entry| entry.values.len() == header.len()), "a row is torn");
    Ok(use_them(&entries))
}

pub(super) fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Why the force of a row went beyond the limit; nothing where it did not.
pub(super) fn why(row: &str) -> Result<&'static str> {
    let text = format!("{}\n{row}\n", super::header());
    entries(&text, |entries| entries.first().filter(|entry| entry.above()).map_or("", Entry::reason))
}

/// The table of a file.
pub(super) fn of_file(path: &Path) -> Result<String> {
    entries(&read(path)?, as_table)
}

/// Lists the failures by reason: count and worst.
pub(super) fn failures(path: &Path) -> Result<String> {
    entries(&read(path)?, failures_of)
}

/// Every cell in which somebody felt more than the limit under the barrier with its speed limit, and why.
pub(super) fn missed(path: &Path) -> Result<String> {
    entries(&read(path)?, missed_of)
}

/// Lists growing taps by the foam's stiffness over its calibration: of people whom the robot drives into.
pub(super) fn growth(path: &Path) -> Result<String> {
    entries(&read(path)?, growth_of)
}

fn growth_of(entries: &[Entry<'_>]) -> String {
    let mut out = String::from(
        "| law | foam over calibration | cells | grows | let go between | later harder than any first by at most |\n\
         |---|---|---|---|---|---|\n",
    );
    for law in ["speed-limit", "barrier", "barrier-alone"] {
        for foam in ["0.5", "1", "2"] {
            let driven = |entry: &&Entry<'_>| ["led", "by hand"].contains(&entry.text("meeting"));
            let of = |entry: &&Entry<'_>| entry.text("law") == law && entry.text("foam") == foam;
            let group: Vec<&Entry<'_>> =
                entries.iter().filter(driven).filter(of).filter(|entry| entry.met()).collect();
            let count = |name: &str| group.iter().filter(|entry| entry.text(name) == "true").count();
            let by_n = |entry: &&Entry<'_>| entry.number("later_n") - entry.number("first_peak_n");
            let (most_n, cells) = (group.iter().map(by_n).fold(0.0, f64::max), group.len());
            // Writing to a string cannot fail.
            let _ = writeln!(
                out,
                "| {law} | × {foam} | {cells} | {} | {} | {most_n:.1} N |",
                count("grows"),
                count("again")
            );
        }
    }
    out
}

fn missed_of(entries: &[Entry<'_>]) -> String {
    let mut out = String::from(
        "| above the limit with the barrier | force | of them at least | met at | why |\n|---|---|---|---|---|\n",
    );
    for entry in entries.iter().filter(|entry| entry.text("law") == "barrier" && entry.above()) {
        let [peak_n, least_n, met_m_s] = ["peak_n", "least_n", "approach_m_s"].map(|name| entry.number(name));
        let (cell, why) = (entry.described(), entry.reason());
        // Writing to a string cannot fail.
        let _ = writeln!(out, "| {cell} | {peak_n:.1} N | {least_n:.1} N | {met_m_s:.3} m/s | {why} |");
    }
    out
}

fn failures_of(entries: &[Entry<'_>]) -> String {
    let mut out = String::from("| law | reason | cells | worst |\n|---|---|---|---|\n");
    let mut reasons: BTreeMap<(&str, &str), Vec<&Entry<'_>>> = BTreeMap::new();
    for entry in entries.iter().filter(|entry| entry.above()) {
        reasons.entry((entry.text("law"), entry.reason())).or_default().push(entry);
    }
    for ((law, reason), failed) in reasons {
        let worst = failed.iter().max_by(|a, b| a.number("peak_n").total_cmp(&b.number("peak_n")));
        let worst = worst.map_or(String::new(), |worst| {
            let [peak_n, least_n] = ["peak_n", "least_n"].map(|name| worst.number(name));
            format!("{peak_n:.0} N (least possible {least_n:.0} N): {}", worst.described())
        });
        // Writing to a string cannot fail.
        let _ = writeln!(out, "| {law} | {reason} | {} | {worst} |", failed.len());
    }
    out
}

fn as_table(entries: &[Entry<'_>]) -> String {
    let mut out = format!(
        "| law | robot | who moves | share of the bound | cells | above {:.0} N | worst in 0.1 s | in 0.5 s | in 3 s | taps | grows | let go between | beyond all first | flange | stopped |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        limit_n()
    );
    let mut row = |law: &str, truth: Option<&str>, meeting: &str, share: Option<&str>| {
        let of = |entry: &&Entry<'_>| {
            entry.text("law") == law
                && truth.is_none_or(|truth| entry.text("truth") == truth)
                && truth.is_some() | (entry.text("truth") != DESCRIBED)
                && entry.text("meeting") == meeting
                && share.is_none_or(|share| entry.text("share") == share)
        };
        let group: Vec<&Entry<'_>> = entries.iter().filter(of).filter(|entry| entry.met()).collect();
        if !group.is_empty() {
            let (truth, share) = (truth.unwrap_or("otherwise"), share.unwrap_or("all"));
            // Writing to a string cannot fail.
            let _ = writeln!(out, "| {law} | {truth} | {meeting} | {share} | {}", line(&group));
        }
    };
    for law in ["speed-limit", "barrier", "barrier-alone"] {
        for meeting in ["led", "by hand", "walks", "leans"] {
            for share in ["0.6", "0.8", "0.95"] {
                row(law, Some(DESCRIBED), meeting, Some(share));
            }
            row(law, None, meeting, None);
        }
    }
    out
}

fn line(group: &[&Entry<'_>]) -> String {
    let most = |name: &str| group.iter().map(|entry| entry.number(name)).fold(0.0, f64::max);
    let above = group.iter().filter(|entry| entry.above()).count();
    let count = |name: &str| group.iter().filter(|entry| entry.text(name) == "true").count();
    let beyond = |entry: &&&Entry<'_>| meeting::grows(entry.number("first_peak_n"), entry.number("later_n"));
    let beyond = group.iter().filter(beyond).count();
    let stopped = group.iter().filter(|entry| !entry.text("stopped").is_empty()).count();
    #[expect(clippy::cast_precision_loss, reason = "cells of one scan")]
    let percent = 100.0 * above as f64 / group.len().max(1) as f64;
    format!(
        "{} | {percent:.1} % | {:.1} N | {:.1} N | {:.1} N | {:.0} | {} | {} | {beyond} | {:.1} mm | {stopped} |",
        group.len(),
        most("first_touch_n"),
        most("impact_n"),
        most("peak_n"),
        most("taps"),
        count("grows"),
        count("again"),
        most("flange_mm"),
    )
}

#[cfg(test)]
#[test]
fn table_counts_excess_and_names_reasons() {
    let text = format!(
        "{}\n\
         0,T5,led,moca,held rigid,1,0.6,as described,1,0.08,speed-limit,0.08,9,30,31,0.3,0.02,9,9,true,true,20,31,1,\n\
         1,T5,led,moca,held rigid,1,0.6,as described,1,0.08,barrier,0.08,9,9,9,0.1,0.02,9,1,false,false,9,0,1,\n\
         2,T5,led,moca,held rigid,1,0.6,as described,1,0.08,barrier-alone,0.08,9,9,27,2.5,0.02,9,3,true,false,27,27.5,1,taxel-invalid\n\
         3,T5,walks,moca,held rigid,1,0.6,as described,1,0.08,barrier,0.08,9,28,28,0.1,0.09,26,1,false,false,9,0,1,\n\
         4,T5,walks,moca,held rigid,1,0.6,as described,1,0.08,barrier,0.08,9,28,28,0.1,0.02,24,1,false,false,9,0,1,\n",
        super::header()
    );
    let table = entries(&text, as_table).unwrap();
    let rows: Vec<&str> = table.lines().skip(2).collect();
    assert_eq!(rows.len(), 4, "{table}");
    assert!(
        rows[0].contains("| 1 | 100.0 % | 9.0 N | 30.0 N | 31.0 N | 9 | 1 | 1 | 1 | 1.0 mm | 0 |"),
        "{table}"
    );
    assert!(
        rows[1].contains("| 1 | 0.0 % |") && rows[3].ends_with("| 3 | 1 | 0 | 0 | 1.0 mm | 1 |"),
        "{table}"
    );
    let growth = entries(&text, growth_of).unwrap();
    for row in [
        "speed-limit | × 1 | 1 | 1 | 1 | 11.0 N",
        "barrier | × 1 | 1 | 0 | 0 | 0.0 N",
        "alone | × 2 | 0 | 0 | 0",
    ] {
        assert!(growth.contains(row), "{growth}");
    }
    assert!(growth.contains("| barrier-alone | × 1 | 1 | 1 | 0 | 0.5 N |"), "{growth}");
    let failures = entries(&text, failures_of).unwrap();
    assert!(failures.contains("| speed-limit | the admittance alone: no row stops it"), "{failures}");
    assert!(
        failures.contains("| barrier-alone | a later contact is harder than the first | 1 |"),
        "{failures}"
    );
    for reason in ["physics: felt so late", "the law: braking"] {
        assert!(failures.contains(&format!("| barrier | {reason}")), "{failures}");
    }
    assert!(entries("a,b\n1\n", as_table).is_err(), "a torn row");
}
