//! Instructions of a control step and the bytes of code and data it touches, against a file of what they may be.
//!
//! `footprint FILE` fails if a case has got more than 2 % above its row, `footprint --bless FILE` writes the file anew, and
//! `footprint --case NAME` is what either runs under valgrind.
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use moca_wbc::testing::footprint::{Footprint, marked, measured};
use moca_wbc::testing::steps::Case;
use std::error::Error;
use std::fmt::Write as _;

const HEADER: &str = "case\tinstructions\tcode bytes\tcode in lines of 64 bytes\tdata in lines of 64 bytes\n";

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["--case", name] => marked(Case::named(name).ok_or("no such case")?),
        ["--bless", file] => Ok(std::fs::write(file, table()?)?),
        [file] => compared(&std::fs::read_to_string(file)?, &table()?),
        _ => Err("footprint [--bless] FILE".into()),
    }
}

fn table() -> Result<String, Box<dyn Error>> {
    let mut table = String::from(HEADER);
    for case in Case::ALL {
        let measured = measured(&std::env::current_exe()?, &["--case", case.name()])?;
        let Footprint { instructions, code_bytes, code_lines_bytes, data_lines_bytes } =
            measured.ok_or("valgrind is not installed: apt-get install valgrind")?;
        let name = case.name();
        writeln!(table, "{name}\t{instructions}\t{code_bytes}\t{code_lines_bytes}\t{data_lines_bytes}")?;
    }
    Ok(table)
}

fn compared(allowed: &str, table: &str) -> Result<(), Box<dyn Error>> {
    print!("{table}");
    if allowed.lines().count() != table.lines().count() {
        return Err("the file has other cases".into());
    }
    let mut beyond = String::new();
    let columns: Vec<&str> = HEADER.trim_end().split('\t').collect();
    for (allowed, now) in allowed.lines().zip(table.lines()).skip(1) {
        let case = now.split('\t').next().unwrap_or_default();
        for ((allowed, now), what) in allowed.split('\t').zip(now.split('\t')).zip(&columns).skip(1) {
            let (most, is) = (allowed.parse::<f64>()? * 1.02, now.parse::<f64>()?);
            if is > most {
                writeln!(beyond, "{case}: {is} {what} are more than {allowed} by over 2 %")?;
            }
        }
    }
    if beyond.is_empty() { Ok(()) } else { Err(beyond.into()) }
}
