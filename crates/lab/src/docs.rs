//! `moca-lab docs`: the tables of figures in the documents, written by the code that computes them.
//!
//! A short table stands in a document, between `<!-- moca-lab docs NAME … -->` and `<!-- end of NAME -->`; the text around it
//! is for people. A long one is a file of its own, `docs/data/NAME.csv`.

mod data;

use crate::cover::latency;
use crate::numerics::{barrier, bench, peers, stability, tick};
use crate::paper::report::{claims, errors};
use crate::paper::{flange_wrench, late_bases, real_arm};
use crate::robustness::{attack, faults, lean, long_lean, protection};
use anyhow::{Context, Result, bail, ensure};
use moca_experiments::{c_library, count};
use moca_figures::progress;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Writes the tables of figures into the documents.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The repository.
    #[arg(long, default_value = ".")]
    repository: PathBuf,
    /// Only this table; without it, all.
    #[arg(long)]
    only: Option<String>,
}

/// A table of figures and the document that shows it.
struct Table {
    name: &'static str,
    /// A Markdown document with a place for the table, or a CSV file that holds nothing else.
    file: &'static str,
    make: fn() -> Result<String>,
}

const fn table(name: &'static str, file: &'static str, make: fn() -> Result<String>) -> Table {
    Table { name, file, make }
}

const TABLES: &[Table] = &[
    table("faults", "docs/safety.md", faults::markdown),
    table("attack", "docs/safety.md", attack::markdown),
    table("lean", "docs/safety.md", lean::markdown),
    table("long-lean", "docs/data/long-lean.csv", long_lean::markdown),
    table("boards", "docs/boards.md", latency::markdown),
    table("paper", "docs/results.md", claims::markdown),
    table("late-bases", "docs/results.md", late_bases::markdown),
    table("real-arm", "docs/data/real-arm.csv", real_arm::markdown),
    table("flange-wrench", "docs/data/flange-wrench.csv", flange_wrench::markdown),
    table("barrier", "docs/math.md", barrier::markdown),
    table("protection-short", "docs/data/protection-short.csv", protection::markdown),
    table("protection-leads", "docs/data/protection-leads.csv", protection::leads_markdown),
    table("protection-campaign", "docs/data/protection-campaign.csv", protection::campaign_markdown),
    table("protection-random", "docs/data/protection-random.csv", protection::random_markdown),
    table("bench", "docs/results.md", bench::markdown),
    table("step-size", "docs/results.md", tick::markdown),
    table("errors", "docs/data/errors.csv", errors::markdown),
    table("contact", "docs/data/contact.csv", stability::contact::markdown),
    table("peers", "docs/simulation.md", peers::markdown),
    table("stability", "docs/data/stability.csv", stability::markdown),
    table("stability-maps", "docs/data/stability-maps.csv", stability::maps::markdown),
];

/// Computes the tables and puts each in its place.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let chosen = |table: &&Table| arguments.only.as_deref().is_none_or(|only| only == table.name);
    let names = || TABLES.iter().map(|table| table.name).collect::<Vec<_>>().join(", ");
    ensure!(TABLES.iter().any(|table| chosen(&table)), "--only: not one of {}", names());
    let tables: Vec<&Table> = TABLES.iter().filter(chosen).collect();
    let (done, all) = (Arc::new(AtomicUsize::new(0)), count(tables.len()));
    let seen = Arc::clone(&done);
    // One bar for the whole run: those of the tables are within it.
    let bar = progress::following("docs", move || count(seen.load(Ordering::Relaxed)) / all);
    let mut written = Vec::new();
    let result = write_tables(&tables, &arguments.repository, |line| {
        done.fetch_add(1, Ordering::Relaxed);
        written.push(line);
    });
    drop(bar);
    for line in written {
        println!("{line}");
    }
    result
}

/// Computes tables and puts each in its place; `done` gets a line about each.
fn write_tables(tables: &[&Table], repository: &Path, mut done: impl FnMut(String)) -> Result<()> {
    for table in tables {
        let path = repository.join(table.file);
        let fresh = (table.make)()?;
        let written = if data::is_data(table.file) {
            data::encode(&title(table.name), &fresh)?
        } else {
            let text = read(&path)?;
            let (before, _, after) = split(&text, table.name)?;
            format!("{before}{}\n{fresh}{after}", head(table.name))
        };
        std::fs::write(&path, written).with_context(|| format!("cannot write {}", path.display()))?;
        done(format!("{}: table {}", path.display(), table.name));
    }
    Ok(())
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Command that writes a table, and the C library: its sines decide the last digits of a simulation.
fn title(name: &str) -> String {
    format!("moca-lab docs {name}, C library {:016x}", c_library())
}

/// Line above a table in a document.
fn head(name: &str) -> String {
    format!("<!-- {} -->", title(name))
}

/// Text before the table's head, head with table, and the text from its end on.
fn split<'a>(text: &'a str, name: &str) -> Result<(&'a str, &'a str, &'a str)> {
    // with what follows a whole name: another's may begin like it
    let start = [" -->", ", "].iter().find_map(|end| text.find(&format!("<!-- moca-lab docs {name}{end}")));
    let end = text.find(&format!("<!-- end of {name} -->"));
    match (start, end) {
        (Some(start), Some(end)) if start < end => Ok((&text[..start], &text[start..end], &text[end..])),
        _ => bail!("no place for table {name}: <!-- moca-lab docs {name} --> … <!-- end of {name} -->"),
    }
}

/// Returns a table as [`shown`] would after it has been written.
#[cfg(test)]
pub(crate) fn as_shown(name: &str, markdown: &str) -> String {
    let table = TABLES.iter().find(|table| table.name == name).unwrap();
    if data::is_data(table.file) {
        data::decode(&data::encode("title", markdown).unwrap()).unwrap().1
    } else {
        markdown.to_owned()
    }
}

/// A table as its document has it; `None` where it was written with another C library, whose last digits are others.
#[cfg(test)]
pub(crate) fn shown(name: &str) -> Option<String> {
    let table = TABLES.iter().find(|table| table.name == name).unwrap();
    let repository = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let text = read(&repository.join(table.file)).unwrap();
    let shown = if data::is_data(table.file) {
        let (title, table) = data::decode(&text).unwrap();
        format!("<!-- {title} -->\n{table}")
    } else {
        split(&text, name).unwrap().1.to_owned()
    };
    assert!(shown.lines().count() > 3, "{name}: no table");
    (shown.lines().next() == Some(head(name).as_str())).then_some(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_not_taken_for_one_whose_name_begins_like_it() {
        let text = "a\n<!-- moca-lab docs map-b, C library 0 -->\n1\n<!-- end of map-b -->\n\
                    <!-- moca-lab docs map, C library 0 -->\n2\n<!-- end of map -->\n";
        assert_eq!(split(text, "map").unwrap().1, "<!-- moca-lab docs map, C library 0 -->\n2\n");
        assert_eq!(split(text, "map-b").unwrap().0, "a\n");
        assert!(split(text, "ma").is_err());
        let fresh = "<!-- moca-lab docs map --> <!-- end of map -->";
        assert_eq!(split(fresh, "map").unwrap().2, "<!-- end of map -->");
    }

    #[test]
    fn progress_of_a_run_counts_every_table_once() {
        let folder = std::env::temp_dir().join(format!("moca-docs-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let place = |name: &str| format!("<!-- moca-lab docs {name} --> <!-- end of {name} -->\n");
        std::fs::write(folder.join("page.md"), place("one") + &place("two")).unwrap();
        let table = |name| table(name, "page.md", || Ok("| 1 |\n".into()));
        let (tables, mut lines) = ([table("one"), table("two")], Vec::new());
        write_tables(&tables.each_ref(), &folder, |line| lines.push(line)).unwrap();
        assert!(lines[0].ends_with("table one") && lines[1].ends_with("table two"), "{lines:?}");
        assert_eq!(lines.len(), 2);
        let page = std::fs::read_to_string(folder.join("page.md")).unwrap();
        assert_eq!(page.matches("| 1 |").count(), 2);
    }

    fn is_what_is_printed(name: &str) {
        if let Some(shown) = shown(name) {
            let make = TABLES.iter().find(|table| table.name == name).unwrap().make;
            let fresh = format!("{}\n{}", head(name), as_shown(name, &make().unwrap()));
            for (shown, fresh) in shown.lines().zip(fresh.lines()) {
                assert_eq!(shown, fresh, "`moca-lab docs --only {name}` writes it anew");
            }
            assert_eq!(shown.lines().count(), fresh.lines().count());
        }
    }

    /// A test that computes a whole table and compares it with its document.
    macro_rules! printed {
        ($($test:ident: $table:literal),+ $(,)?) => {
            $(#[test]
            fn $test() {
                is_what_is_printed($table);
            })+
        };
    }

    printed! {
        table_paper_matches_the_experiments: "paper",
        table_of_late_bases_matches_the_collisions: "late-bases",
        table_of_flange_wrenches_matches_its_file: "flange-wrench",
        table_protection_campaign_matches_its_file: "protection-campaign",
        table_of_drawn_meetings_matches_their_file: "protection-random",
        what_a_step_needs_is_what_it_is_held_to: "step-size",
        table_faults_matches_the_trials: "faults",
        what_each_board_allows_is_what_latency_prints: "boards",
    }

    /// All of them take minutes: one in ten is run, and has to stand where the table has it.
    #[test]
    fn cases_of_the_stability_table_come_out_where_it_has_them() {
        let Some(shown) = shown("stability") else { return };
        let named = |row: &str| -> Vec<&str> {
            let line = shown.lines().find(|line| line.starts_with(&format!("| {row} |"))).unwrap();
            line.split_once('(').unwrap().1.trim_end_matches(") |").split(", ").collect()
        };
        let (unbounded, stopped) = (named("not bounded"), named("the robot stopped by itself"));
        let cases = stability::one_in(10).unwrap();
        assert!(cases.len() > 5 && unbounded.len() > 5);
        for case in cases {
            let name = case.name.as_str();
            assert_eq!(unbounded.contains(&name), case.touched() && !case.bounded, "{case:?}");
            let stop = case.stop();
            assert_eq!(
                stop.as_deref(),
                stopped.iter().copied().find(|stop| stop.starts_with(&format!("{name}: "))),
                "{case:?}"
            );
        }
    }

    /// All of them take minutes: the paper's collision, hands that add up and the hardest contacts at the front are run.
    #[test]
    fn error_bars_in_the_documents_are_what_is_printed() {
        let Some(shown) = shown("errors") else { return };
        let short = ["C, 100 Hz sensor", "B2-iii, hands that add up", "a leg of 50 N/mm at T6, barrier on"];
        let rows = errors::rows(|group| short.contains(&group)).unwrap();
        assert_eq!(rows.len(), 7 + 1 + 1);
        for row in rows {
            assert!(
                shown.lines().any(|line| line == row),
                "`moca-lab docs --only errors` writes it anew: {row}"
            );
        }
    }

    /// All of them take minutes: a few are run.
    #[test]
    fn cases_of_the_loop_in_contact_come_out_as_the_table_has_them() {
        let Some(shown) = shown("contact") else { return };
        let cases = stability::contact::few().unwrap();
        assert_eq!(cases.len(), 4);
        let (map, rows) = cases.split_at(2);
        for case in map {
            let verdict = stability::contact::verdict(case);
            assert!(shown.contains(&format!("| {verdict} |")), "{case:?}");
        }
        for row in rows.iter().map(stability::contact::row) {
            assert!(shown.lines().any(|line| line.starts_with(&row)), "{row}");
        }
        let (single, _) = stability::contact::single_line(1.0).unwrap();
        assert!(shown.lines().any(|line| line.starts_with(&single)), "{single}");
    }

    /// All of them take minutes: of each cell the hardest collision, which it names, is run.
    #[test]
    fn hardest_collisions_match_table_barrier() {
        let Some(shown) = shown("barrier") else { return };
        let cells = barrier::named_by(&shown).unwrap();
        assert_eq!(cells.len(), 8, "each cell names one run");
        for (shown, fresh) in cells {
            assert!(shown.starts_with(&fresh), "{shown}: {fresh}");
        }
    }

    /// All of them take an hour: one lean of five minutes is run.
    #[test]
    fn long_lean_matches_its_row() {
        let Some(shown) = shown("long-lean") else { return };
        let row = long_lean::row_named("home, follow-me, T10 100 N").unwrap();
        assert!(shown.lines().any(|line| line == row.trim_end()), "`moca-lab docs --only long-lean`: {row}");
    }

    /// All of them are hours of a robot: one lean of five minutes is run.
    #[test]
    fn attack_matches_its_row() {
        let Some(shown) = shown("attack") else { return };
        let row = attack::row_named("lean T3 40 N, impedance, moca").unwrap();
        assert!(shown.lines().any(|line| line == row.trim_end()), "`moca-lab docs --only attack`: {row}");
    }

    /// Words of a document, and how the row begins that has their figures.
    type Quote = (&'static str, &'static str);

    /// Quotes of a table in the words of a document: file, table, quotes.
    const QUOTED: &[(&str, &str, &[Quote])] = &[
        (
            "README.md",
            "paper",
            &[
                ("24.2 N with the cover", "C peak force, 100 Hz sensor"),
                ("| 179.8 N without the cover", "C without the cover"),
            ],
        ),
        (
            "README.md",
            "late-bases",
            &[
                ("| 3.5 N with the contact barrier | 61.4 N", "PU LD30 | 0 |"),
                ("| 4.4 N with the contact barrier | 162.7 N", "PU LD30 | 50 |"),
                ("meets the leg at 0.012 m/s", "PU LD30 | 50 |"),
            ],
        ),
        ("docs/results.md", "late-bases", &[("ends at 61.4 N", "PU LD30 | 0 |")]),
        (
            "docs/results.md",
            "real-arm",
            &[
                ("| off | 0.13 | 6.03 | 12.30 | 4.14 | 17.29 |", "push T1 20 N | off"),
                ("| on | 0.13 | 0.16 | 0.19 | 2.33 | 2.34 |", "push T1 20 N | on |"),
                ("| 0.13 | 0.16 | 0.19 | 0.90 | 1.00 |", "push T1 20 N | on, 80 %"),
            ],
        ),
        (
            "docs/results.md",
            "flange-wrench",
            &[
                ("| as believed | true | 0.00 | 0.00 | 0.00 | 0.504 |", "as believed | true"),
                ("| as believed | observer | 0.21 | 0.12 | 0.00 | 0.503 |", "as believed | observer"),
                ("| as believed | sensor | 0.16 | 0.15 | 0.12 | 0.504 |", "as believed | sensor"),
                ("| observer | 4.23 | 1.70 | 1.07 | 0.318 |", "friction 1 N·m | observer"),
                ("| sensor | 0.16 | 0.15 | 0.12 | 0.504 |", "friction 1 N·m | sensor"),
                ("| sensor | 0.15 | 0.12 | 0.18 | 0.504 |", "believed tool of 1 kg, turned | sensor"),
                ("| observer | 0.30 | 0.28 | 9.81 | 0.502 |", "unknown tool of 1 kg | observer"),
                ("| sensor | 0.17 | 0.16 | 0.13 | 0.503 |", "unknown tool of 1 kg | sensor"),
                ("| sensor | 4.16 | 5.63 | 3.06 | 0.448 |", "unknown tool of 1 kg, turned | sensor"),
            ],
        ),
        (
            "README.md",
            "barrier",
            &[
                ("drives at up to 0.064 m/s", "stock, 50 N/mm"),
                ("18 N with the contact barrier | 181 N", "stock, 50 N/mm"),
            ],
        ),
        (
            "docs/safety.md",
            "barrier",
            &[
                ("feels 18 N instead of 181 N", "stock, 50 N/mm"),
                ("21 N instead of 189 N", "100 Hz, 50 N/mm"),
            ],
        ),
        (
            "docs/results.md",
            "protection-campaign",
            &[
                ("| led | 0.95 of the bound | 19.8 N |", "barrier | as described | led | 0.95 |"),
                ("| 71 N |", "speed-limit | as described | led | 0.95 |"),
                ("| led | 0.8 of the bound | 14.8 N |", "barrier | as described | led | 0.8 |"),
                ("| 1068 N |", "speed-limit | as described | led | 0.8 |"),
                ("| by hand | 0.95 of the bound | 15.1 N |", "barrier | as described | by hand | 0.95 |"),
                ("| 30 N |", "speed-limit | as described | by hand | 0.95 |"),
                ("than described | all | 18.4 N |", "barrier | otherwise | led | all"),
                ("| 660 N |", "speed-limit | otherwise | led | all"),
                ("1 of 31 led cells grows", "barrier | as described | led | 0.95 |"),
                ("none grows in 119 cells", "barrier | × 0.5 |"),
                ("1 of 105 as calibrated", "barrier | × 1 |"),
                ("exceeds all first peaks by 0.4 N", "barrier | × 1 |"),
                ("2 of 127 at twice", "barrier | × 2 |"),
                ("most 1.9 N", "barrier | × 2 |"),
                ("of the bound 3.1 % of 32 cells", "barrier | as described | walks | 0.95 |"),
                ("at most 27.1 N", "barrier | as described | walks | 0.95 |"),
                ("with 38 N at most", "barrier-alone | a later contact"),
            ],
        ),
        (
            "docs/results.md",
            "errors",
            &[("goes 29.480 mm with one seed and 209.067", "pushes, barrier off and on | way of the base")],
        ),
        ("docs/results.md", "contact", &[("at the first touch leaves 17 N", "no bytes any more")]),
        (
            "docs/safety.md",
            "long-lean",
            &[
                ("more than 93.7 % of a limit", "near an end | impedance | 66 |"),
                ("at most 17.7 % of a joint's speed", "stretched | impedance | 66 |"),
                ("at most 17.5 %", "home | impedance | 66 |"),
                ("within 0.3 s and", "home | impedance | 66 |"),
            ],
        ),
        (
            "docs/safety.md",
            "protection-leads",
            &[("feels at most 22.6 N", "stock-2018 | off | by hand | 0.25 |")],
        ),
        (
            "docs/results.md",
            "protection-leads",
            &[("meets somebody: 21.0 N at most", "stock-2018 | on | led | 0.25 |")],
        ),
        (
            "docs/what-no-hardware-has-confirmed.md",
            "boards",
            &[("| 247 refreshes a second", "moca firmware, as read"), ("at most 9.7 ms old", "moca |")],
        ),
        ("firmware/moca_touch/README.md", "boards", &[("(about 247 a second)", "moca firmware, as read")]),
        (
            "crates/tactile/README.md",
            "boards",
            &[
                ("40.5 frames/s, data up to 56.0 ms old", "stock-2018"),
                ("67.6 and 38.0 ms", "stock-2015"),
                ("246.8 and 9.5 ms", "moca firmware, as read"),
            ],
        ),
        ("CHANGELOG.md", "boards", &[("247 refreshes a second", "moca firmware, as read")]),
        (
            "docs/results.md",
            "protection-random",
            &[
                ("(3160 met, 10.6 N at most)", "led | stands | 1 |"),
                ("on two (9.2 N)", "led | stands | 2 |"),
                ("on three (10.4 N)", "led | stands | 3 |"),
                ("it is 13.1 N at most", "by hand | stands | 1 |"),
                ("in 0 of 974 meetings", "walks | walks, within the bound of any law | 1 |"),
                ("within that bound, 24.9 N at most", "walks | walks, within the bound of any law | 1 |"),
                ("it is 0 of 76", "walks | walks, within the bound of any law | 2 |"),
                ("on three 0 of 70", "walks | walks, within the bound of any law | 3 |"),
                ("in 0 of 343 meetings", "led | walks, within the bound of any law | 1 |"),
                ("exceeds the best by 0.0 N", "stock-2015 | 0.06 to 0.1 |"),
                ("it does so by 247.3 N at most", "stock-2015 | 0.06 to 0.1 |"),
                ("grow: 0 of 974", "walks | walks, within the bound of any law | 1 |"),
                ("(458 of 1597 on one plate)", "by hand | stands | 1 |"),
                ("robot is within 18.5 mm", "led | stands | 1 |"),
                ("by hand within 29.5 mm", "by hand | stands | 1 |"),
            ],
        ),
    ];

    #[test]
    fn what_is_quoted_of_a_table_stands_in_it() {
        let numbers = |text: &str| -> Vec<String> {
            let parts = text.split(|c: char| !(c.is_ascii_digit() || c == '.'));
            let numbers = parts.filter(|part| part.parse::<f64>().is_ok());
            numbers.map(|number| number.trim_end_matches('.').to_owned()).collect()
        };
        let quoted =
            QUOTED.iter().flat_map(|(file, table, rows)| rows.iter().map(move |row| (file, table, row)));
        for (file, table, (words, row)) in quoted {
            let text = read(&Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join(file)).unwrap();
            let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(text.contains(words), "{file} no longer says: {words}");
            let Some(shown) = shown(table) else { continue };
            let line = shown.lines().find(|line| line.starts_with(&format!("| {row}"))).unwrap();
            let there = |number: &String| {
                let digits = number.split_once('.').map_or(0, |(_, digits)| digits.len());
                let rounded = |other: &String| format!("{:.digits$}", other.parse::<f64>().unwrap());
                numbers(line).iter().any(|other| rounded(other) == *number)
            };
            let figures = numbers(words);
            assert!(!figures.is_empty() && figures.iter().all(there), "{file}: {words}\n{table}: {line}");
        }
    }

    #[test]
    fn a_table_without_a_place_is_refused() {
        assert!(split("text", "paper").is_err());
        let text = "a <!-- moca-lab docs paper, old -->\n|x|\n<!-- end of paper --> b";
        let (before, table, after) = split(text, "paper").unwrap();
        assert_eq!((before, after), ("a ", "<!-- end of paper --> b"));
        assert!(table.ends_with("|x|\n"));
    }
}
