//! `mocad log`: what is in a log and what it costs.

use crate::cli::progress::Progress;
use anyhow::Result;
use moca_msgs::Mode;
use moca_telemetry::log::{LogFile, LogSizes, Overview, overview::Happening};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Say what is in logs: length, touches, stops, faults, and bytes for each hour.
#[derive(clap::Args)]
pub struct Arguments {
    /// MCAP files of `mocad --record` or of the dashboard.
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

/// Prints a paragraph for each file.
///
/// # Errors
/// A file is no log, or is damaged beyond its index.
pub fn run(arguments: &Arguments) -> Result<String> {
    let mut text = String::new();
    for path in &arguments.files {
        text += &about(path)?;
    }
    Ok(text)
}

fn about(path: &Path) -> Result<String> {
    let mut progress = Progress::new(path.display().to_string());
    let mut log = LogFile::open(path)?;
    let sizes = log.sizes(&mut |part| progress.at(part))?;
    let cut = log.cut().map_or_else(String::new, |cut| format!("  not whole: {cut}\n"));
    let overview = match log.overview() {
        Some(overview) => overview.clone(),
        None => log.build_overview(&mut |part| progress.at(part)).clone(),
    };
    progress.end();
    Ok(format!("{}: {}{cut}", path.display(), paragraph(&sizes, &overview)))
}

#[expect(clippy::cast_precision_loss, reason = "figures for people")]
fn paragraph(sizes: &LogSizes, overview: &Overview) -> String {
    let mut text = format!(
        "{:.1} s of a run, {:.1} MB, {:.3} GB an hour\n",
        sizes.span_ns as f64 * 1e-9,
        sizes.file as f64 * 1e-6,
        sizes.gigabytes_per_hour(sizes.file)
    );
    let parts =
        [("for viewers", sizes.display), ("the boards' bytes", sizes.board), ("for a replay", sizes.replay)];
    for (name, bytes) in parts {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "  {name:<18}{:.3} GB an hour", sizes.gigabytes_per_hour(bytes));
    }
    let count =
        |wanted: &dyn Fn(&Happening) -> bool| overview.marks.iter().filter(|mark| wanted(&mark.what)).count();
    let touches = count(&|what| matches!(what, Happening::Touch));
    let stops = count(&|what| matches!(what, Happening::Mode(Mode::ProtectiveStop)));
    let faults = count(&|what| matches!(what, Happening::Fault(_)));
    let limits = count(&|what| matches!(what, Happening::LimitCrossed));
    let _ = writeln!(
        text,
        "  {touches} touches, {limits} contact limits crossed, {stops} protective stops, {faults} faults"
    );
    if overview.marks_dropped > 0 {
        let _ = writeln!(text, "  {} more that found no room in the overview", overview.marks_dropped);
    }
    text
}
