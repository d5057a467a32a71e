//! Parts that studies share: cases with their outcomes, columns of a table, and the form of a command's answer.

use anyhow::Result;
pub(crate) use moca_experiments::campaign::Column;
use moca_experiments::parallel;
use serde::Serialize;
use std::fmt::Write as _;

/// Runs every case on all cores and returns each with its outcome.
pub(crate) fn outcomes<C: Sync, O: Send>(
    name: &str,
    cases: Vec<C>,
    run: impl Fn(&C) -> Result<O> + Sync,
) -> Result<Vec<(C, O)>> {
    let outcomes = parallel::run(name, &cases, run)?;
    Ok(cases.into_iter().zip(outcomes).collect())
}

/// Returns the rows in groups of one key each, in the order in which the keys first appear.
pub(crate) fn groups<R: Clone, K: PartialEq>(rows: &[R], key: impl Fn(&R) -> K) -> Vec<Vec<R>> {
    let mut groups: Vec<Vec<R>> = Vec::new();
    for row in rows {
        match groups.iter_mut().find(|group| key(&group[0]) == key(row)) {
            Some(group) => group.push(row.clone()),
            None => groups.push(vec![row.clone()]),
        }
    }
    groups
}

/// Returns rows as a table in Markdown.
pub(crate) fn table<R>(columns: &[Column<R>], rows: &[R]) -> String {
    let headings: Vec<&str> = columns.iter().map(|(heading, _)| *heading).collect();
    let rule = "|---".repeat(columns.len());
    let rows: String = rows.iter().map(|row| line(columns, row)).collect();
    format!("| {} |\n{rule}|\n{rows}", headings.join(" | "))
}

/// Returns one row of that table, with the end of its line.
pub(crate) fn line<R>(columns: &[Column<R>], row: &R) -> String {
    let cells: Vec<String> = columns.iter().map(|(_, cell)| cell(row)).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// Form in which a command answers.
#[derive(clap::Args, Clone)]
pub(crate) struct Answer {
    /// Prints JSON instead of tables.
    #[arg(long)]
    json: bool,
}

impl Answer {
    /// Prints text, or one JSON object.
    pub(crate) fn print(
        &self,
        findings: &impl Serialize,
        text: impl FnOnce() -> Result<String>,
    ) -> Result<()> {
        print(&if self.json { serde_json::to_string_pretty(findings)? } else { text()? });
        Ok(())
    }

    /// Prints text, or one JSON object for each case.
    pub(crate) fn print_cases<C: Serialize, O: Serialize>(
        &self,
        cases: &[(C, O)],
        text: impl FnOnce() -> Result<String>,
    ) -> Result<()> {
        let object = |(cell, outcome): &(C, O)| {
            format!("{}\n", serde_json::json!({ "cell": cell, "outcome": outcome }))
        };
        print(&if self.json { cases.iter().map(object).collect() } else { text()? });
        Ok(())
    }
}

/// Prints text with its tables aligned.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn print(text: &str) {
    println!("{}", aligned(text).trim_end());
}

/// Cells of a Markdown row; `None` for other lines.
pub(crate) fn cells(line: &str) -> Option<Vec<&str>> {
    let row = line.strip_prefix('|')?.trim_end().strip_suffix('|')?;
    Some(row.split('|').map(str::trim).collect())
}

/// Text in which each column of a Markdown table is as wide as its widest cell.
pub(crate) fn aligned(text: &str) -> String {
    let lines: Vec<(&str, Option<Vec<&str>>)> =
        text.split_inclusive('\n').map(|line| (line, cells(line))).collect();
    let mut out = String::with_capacity(text.len());
    for block in lines.chunk_by(|(_, a), (_, b)| a.is_some() && b.is_some()) {
        let rows = || block.iter().filter_map(|(_, cells)| cells.as_ref());
        let width =
            |column: usize| rows().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max();
        let widths: Vec<usize> = (0..).map_while(width).collect();
        for (line, row) in block {
            let Some(row) = row else {
                out.push_str(line);
                continue;
            };
            for (cell, width) in row.iter().zip(&widths) {
                let fill = if cell.starts_with("---") { "-" } else { " " };
                // Writing to a string cannot fail.
                let _ = write!(out, "| {cell}{} ", fill.repeat(width - cell.chars().count()));
            }
            out.push_str("|\n");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: &[Column<(f64, &str)>] =
        &[("force, N", |row| format!("{:.1}", row.0)), ("", |row| row.1.into())];

    #[test]
    fn table_has_a_line_for_each_row_and_aligns_its_columns() {
        let table = table(COLUMNS, &[(1.25, "µ"), (100.0, "held")]);
        assert_eq!(table, "| force, N |  |\n|---|---|\n| 1.2 | µ |\n| 100.0 | held |\n");
        let text = format!("no table\n{table}no | table\n");
        let wide = "no table\n| force, N |      |\n| -------- | ---- |\n| 1.2      | µ    |\n| 100.0    | held |\nno | table\n";
        assert_eq!(aligned(&text), wide);
    }

    #[test]
    fn groups_keep_the_order_of_their_first_rows() {
        assert_eq!(groups(&[3, 1, 5, 2], |n| n % 2), [vec![3, 1, 5], vec![2]]);
        let cases = outcomes("", vec![2, 3], |n| Ok(n * n)).unwrap();
        assert_eq!(cases, [(2, 4), (3, 9)]);
    }
}
