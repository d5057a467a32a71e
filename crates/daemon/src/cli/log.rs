//! `mocad log` and `mocad logs`: what happened in a run, and which runs there are.

use crate::cli::log_story::{Story, clock};
use crate::cli::progress::Progress;
use crate::record::flight_recorder::auto_folder;
use anyhow::{Context, Result, bail};
use moca_msgs::Mode;
use moca_telemetry::log::{LogFile, LogReader, LogSizes, Overview, Record, overview::Happening};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Say what happened in logs: date and length, stops with cause and remedy, touches, gaps, who asked for what, and bytes for each hour.
#[derive(clap::Args)]
pub struct Arguments {
    /// MCAP files of `mocad --record`, of the flight recorder or of the dashboard.
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

/// List the logs of a folder, the newest first: date, length, stops, touches.
#[derive(clap::Args)]
pub struct ListArguments {
    /// Without it the flight recorder's.
    folder: Option<PathBuf>,
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
    let (start_unix_ns, (first_ns, last_ns)) = (log.start_unix_ns(), log.range_ns());
    let sizes = log.sizes(&mut |part| progress.at(0.5 * part))?;
    let name = log.description().name.clone();
    let mut text = format!(
        "{}: robot {name:?}, {} to {}, {:.1} s\n",
        path.display(),
        clock(start_unix_ns, first_ns),
        clock(start_unix_ns, last_ns),
        moca_msgs::seconds(last_ns.saturating_sub(first_ns))
    );
    if let Some(cut) = log.cut() {
        // Writing into a String cannot fail.
        let _ = writeln!(text, "  not whole    {cut}");
    }
    let mut story = Story::new(start_unix_ns);
    let mut reader = LogReader::open(path)?;
    while let Some(record) = reader.next() {
        match record {
            Record::Sample(sample) => {
                story.add(&sample);
                progress.at(0.5 + 0.5 * reader.part_read());
            }
            Record::Asked(_, asked) => story.asked(&asked),
            _ => {}
        }
    }
    progress.end();
    if story.is_empty() {
        let why = log.cut().map_or_else(String::new, |cut| format!(": {cut}"));
        bail!("{} holds no whole sample{why}", path.display());
    }
    let _ = write!(text, "{story}{}", size(&sizes));
    Ok(text)
}

#[expect(clippy::cast_precision_loss, reason = "figures for people")]
fn size(sizes: &LogSizes) -> String {
    let an_hour = |bytes| sizes.gigabytes_per_hour(bytes);
    format!(
        "  size         {:.1} MB, {:.3} GB an hour: for viewers {:.3}, the boards' bytes {:.3}, for a replay {:.3}\n",
        sizes.file as f64 * 1e-6,
        an_hour(sizes.file),
        an_hour(sizes.display),
        an_hour(sizes.board),
        an_hour(sizes.replay)
    )
}

/// Prints a line for each log of a folder.
///
/// # Errors
/// The folder cannot be read.
pub fn list(arguments: &ListArguments) -> Result<String> {
    let folder = arguments.folder.clone().unwrap_or_else(auto_folder);
    let entries = std::fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let paths: Vec<PathBuf> = paths.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect();
    let mut progress = Progress::new(folder.display().to_string());
    let mut rows = Vec::new();
    for (done, path) in paths.iter().enumerate() {
        progress.count(done, paths.len());
        rows.push(row(path));
    }
    progress.end();
    rows.sort();
    rows.reverse();
    let mut text = format!("{}: {} logs\n", folder.display(), rows.len());
    for (_, row) in rows {
        text += &row;
        text.push('\n');
    }
    Ok(text)
}

/// A log's begin, ns since the Unix epoch, and its line.
fn row(path: &Path) -> (u64, String) {
    let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let mut log = match LogFile::open(path) {
        Ok(log) => log,
        Err(error) => return (0, format!("  {name}: {error}")),
    };
    let (first_ns, last_ns) = log.range_ns();
    let begin_ns = log.start_unix_ns();
    let cut = if log.cut().is_some() { ", not whole" } else { "" };
    let overview = match log.overview() {
        Some(overview) => overview.clone(),
        None => log.build_overview(&mut |_| {}).clone(),
    };
    let length_s = moca_msgs::seconds(last_ns.saturating_sub(first_ns));
    let line = format!(
        "  {}  {length_s:8.1} s  {:3} stops  {:4} touches  {name}{cut}",
        clock(begin_ns, first_ns),
        count(&overview, |what| matches!(what, Happening::Mode(Mode::ProtectiveStop | Mode::Fault))),
        count(&overview, |what| matches!(what, Happening::Touch)),
    );
    (begin_ns.saturating_add(first_ns), line)
}

fn count(overview: &Overview, wanted: impl Fn(Happening) -> bool) -> usize {
    overview.marks.iter().filter(|mark| wanted(mark.what)).count()
}
