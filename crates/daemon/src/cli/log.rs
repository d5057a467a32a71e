//! `mocad log` and `mocad logs`: what happened in a run, and which runs there are.

use crate::cli::log_story::{Told, clock};
use crate::record::flight_recorder::auto_folder;
use anyhow::{Context, Result, bail};
use moca_figures::progress::Progress;
use moca_msgs::Mode;
use moca_telemetry::log::{Account, LogError, LogFile, LogSizes, Overview, overview::Happening};
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
        text += &about(path, LogFile::account)?;
    }
    Ok(text)
}

/// Finds out what a log tells; the callback hears which part is done.
type Ask = fn(&mut LogFile, &mut dyn FnMut(f64)) -> Result<Account, LogError>;

/// Returns the paragraph of a file.
fn about(path: &Path, ask: Ask) -> Result<String> {
    let mut progress = Progress::new(path.display().to_string());
    let mut log = LogFile::open(path)?;
    let (start_unix_ns, (first_ns, last_ns)) = (log.start_unix_ns(), log.range_ns());
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
    let Account { story, sizes } = ask(&mut log, &mut |part| progress.at(part))?;
    progress.end();
    if story.is_empty() {
        let why = log.cut().map_or_else(String::new, |cut| format!(": {cut}"));
        bail!("{} holds no whole sample{why}", path.display());
    }
    let told = Told { story: &story, start_unix_ns };
    let _ = write!(text, "{told}{}", size(&sizes));
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

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{BoardFault, Sample, TaxelReading, TaxelStatus};
    use moca_telemetry::RobotDescription;
    use moca_telemetry::audit::Asked;
    use moca_telemetry::log::{LogWriter, Meta, SerialBytes};

    /// Two and a half minutes with touches, stops, a gap, requests, the boards' bytes and blocks.
    fn log() -> Vec<u8> {
        let mut bytes = Vec::new();
        let description = RobotDescription::paper("told", true);
        let meta = Meta { description, start_unix_ns: 1_790_000_000_000_000_000 };
        let mut log = LogWriter::new(&mut bytes, &meta).unwrap();
        for tick in (0..150_000_u64).filter(|tick| !(70_000..70_900).contains(tick)) {
            let (mode, fault) = match tick % 40_000 {
                30_000..33_000 => (Mode::ProtectiveStop, Some(BoardFault::Lost.of(0))),
                _ => (Mode::Impedance, None),
            };
            let time_ns = tick * 1_000_000;
            let mut sample =
                Sample { tick, time_ns, mode, fault, overruns: tick / 9_000, ..Sample::default() };
            let force_n = if tick % 7_000 < 300 { 1.0 / 3.0 + moca_msgs::seconds(time_ns) } else { 0.0 };
            let untouched = TaxelReading { force_n: 0.0, status: TaxelStatus::Ok };
            sample.taxels.extend([TaxelReading { force_n, ..untouched }, untouched]);
            log.sample(&sample).unwrap();
            if tick % 100 == 0 {
                log.serial(&SerialBytes { board: 0, arrival_ns: time_ns, bytes: b"TOUCH: 0\r\n".to_vec() })
                    .unwrap();
                log.replay(time_ns, &tick.to_le_bytes().repeat(9)).unwrap();
            }
            if tick % 50_000 == 7 {
                let (who, what, answer) = ("user 1000".into(), "arm".into(), String::new());
                log.asked(time_ns, &Asked { who, what, accepted: tick > 60_000, answer, times: 2 }).unwrap();
            }
        }
        log.finish().unwrap();
        bytes
    }

    #[test]
    fn stored_story_is_that_of_all_chunks_even_when_cut() {
        let bytes = log();
        let path = std::env::temp_dir().join(format!("mocad-told-{}.mcap", std::process::id()));
        for part in [100, 99, 70, 45, 20, 5] {
            std::fs::write(&path, &bytes[..bytes.len() * part / 100]).unwrap();
            let told = about(&path, LogFile::account).unwrap();
            assert_eq!(told, about(&path, LogFile::account_of_chunks).unwrap(), "{part} % of the log");
            assert_eq!(told.contains("not whole"), part < 100, "{told}");
            if part == 100 {
                for said in [
                    "stops        3\n",
                    "touches      21, the largest 147.6 N on T1",
                    "gaps         1, 0.92 s in all: 69.98 to 70.90 s",
                ] {
                    assert!(told.contains(said), "{told}");
                }
                assert!(told.contains("user 1000: 2 carried out, 4 refused"), "{told}");
            }
        }
        std::fs::remove_file(path).unwrap();
    }
}
