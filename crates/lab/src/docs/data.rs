//! Tables as CSV files: a title, then one or more tables with their header rows.
//!
//! A line that begins with `#` is text, an empty line separates tables.

use crate::study::cells;
#[cfg(test)]
use anyhow::Context;
use anyhow::{Result, ensure};
use std::fmt::Write;

/// Returns true if `file` holds one table as CSV.
pub(super) fn is_data(file: &str) -> bool {
    file.ends_with(".csv")
}

/// Returns the CSV file of a Markdown table.
///
/// # Errors
/// A row that has another number of cells than the header of its table.
pub(super) fn encode(title: &str, markdown: &str) -> Result<String> {
    let mut out = format!("# {title}\n");
    let mut columns = None;
    for line in markdown.lines().filter(|line| !is_rule(line)) {
        if let Some(cells) = cells(line) {
            let wanted = *columns.get_or_insert(cells.len());
            ensure!(cells.len() == wanted, "{title}: {} cells instead of {wanted}: {line}", cells.len());
            let fields: Vec<String> = cells.iter().map(|cell| field(cell)).collect();
            out.push_str(&fields.join(","));
        } else {
            columns = None;
            if !line.is_empty() {
                write!(out, "# {line}")?;
            }
        }
        out.push('\n');
    }
    Ok(out)
}

/// Returns the title and the Markdown table of a CSV file.
///
/// # Errors
/// A file without a title.
#[cfg(test)]
pub(super) fn decode(csv: &str) -> Result<(&str, String)> {
    let (title, body) = csv.split_once('\n').context("an empty file")?;
    let title = title.strip_prefix("# ").context("a table's file begins with its title")?;
    let mut out = String::new();
    let mut first = true;
    for line in body.lines() {
        if let Some(text) = line.strip_prefix("# ") {
            out.push_str(text);
            first = true;
        } else if line.is_empty() {
            first = true;
        } else {
            let fields = fields(line);
            out.push('|');
            for field in &fields {
                out.push_str(&if field.is_empty() { " |".to_owned() } else { format!(" {field} |") });
            }
            if std::mem::take(&mut first) {
                write!(out, "\n|{}", "---|".repeat(fields.len()))?;
            }
        }
        out.push('\n');
    }
    Ok((title, out))
}

fn is_rule(line: &str) -> bool {
    line.starts_with("|-") && line.chars().all(|c| "|-".contains(c))
}

fn field(cell: &str) -> String {
    if cell.contains([',', '"', '#']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

#[cfg(test)]
fn fields(line: &str) -> Vec<String> {
    let (mut fields, mut quoted) = (vec![String::new()], false);
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '"' if quoted && letters.peek() == Some(&'"') => {
                letters.next();
                fields.last_mut().into_iter().for_each(|field| field.push('"'));
            }
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(String::new()),
            _ => fields.last_mut().into_iter().for_each(|field| field.push(letter)),
        }
    }
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_survive_the_way_through_csv() {
        let markdown = "| a | b |\n|---|---|\n| 1, 2 | \"x\" |\n| 3 | |\n\n| c | d | e |\n|---|---|---|\n| # | 5 | 6 |\n";
        let csv = encode("moca-lab docs x", markdown).unwrap();
        assert_eq!(csv, "# moca-lab docs x\na,b\n\"1, 2\",\"\"\"x\"\"\"\n3,\n\nc,d,e\n\"#\",5,6\n");
        assert_eq!(decode(&csv).unwrap(), ("moca-lab docs x", markdown.to_owned()));
    }

    #[test]
    fn row_with_missing_cell_is_refused() {
        assert!(encode("x", "| a | b |\n| 1 |\n").is_err());
        assert!(decode("no title").is_err());
    }
}
