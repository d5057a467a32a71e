//! Rows of a CSV file, each computed once: resumable, and in shards.

use super::{count, cpu_time, parallel};
use anyhow::{Context, Result, bail, ensure};
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, BufWriter, Seek as _, SeekFrom, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Rows handed out between two writes to the file.
const STRETCH: usize = 64;

/// Table whose rows each follow from their number alone: the rows of any number of shards, joined in order, are those of
/// one machine.
pub trait Table: Send + Sync {
    /// Number of rows.
    fn rows(&self) -> usize;

    /// First line of the file: names of the columns, `run` first.
    fn header(&self) -> String;

    /// Names of the columns that hold words; the others hold numbers.
    fn words(&self) -> Vec<&str>;

    /// Computes row `id` and returns its line, which begins with `id`.
    ///
    /// # Errors
    /// Settings that cannot be run, or a robot that is never armed.
    fn row(&self, id: usize) -> Result<String>;
}

/// Column of a table: its name, and the text of a row's cell.
pub type Column<R> = (&'static str, fn(&R) -> String);

/// Names of columns, separated by commas.
pub fn names<R>(columns: &[Column<R>]) -> String {
    columns.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(",")
}

/// Cells of a row, separated by commas.
pub fn cells<R>(columns: &[Column<R>], row: &R) -> String {
    columns.iter().map(|(_, cell)| cell(row)).collect::<Vec<_>>().join(",")
}

/// File of the rows of a table, or of one shard of them.
#[derive(Clone, Copy)]
pub struct Campaign<'a> {
    /// Table of all shards.
    pub table: &'a dyn Table,
    /// Rows that are already in it are kept and not computed again.
    pub out: &'a Path,
    /// As [`shard`] reads it; only the first shard has the header.
    pub shard: (usize, usize),
}

/// Cost of a campaign.
pub struct Ran {
    out: String,
    now: usize,
    before: usize,
    wall_s: f64,
    cpu_s: f64,
}

impl Ran {
    /// Rows per second of CPU time.
    pub fn per_cpu_s(&self) -> f64 {
        count(self.now) / self.cpu_s.max(1e-9)
    }
}

impl fmt::Display for Ran {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} runs now, {} before, in {:.1} s on {} cores: {:.1} runs/s",
            self.out,
            self.now,
            self.before,
            self.wall_s,
            std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            count(self.now) / self.wall_s.max(1e-9),
        )
    }
}

impl Campaign<'_> {
    /// Computes what is missing of this shard.
    ///
    /// # Errors
    /// As for [`Campaign::open`] and [`Table::row`]; the rows before the error are in the file.
    pub fn run(&self) -> Result<Ran> {
        let (mut file, before, range) = self.open()?;
        let (started, cpu_before_s) = (Instant::now(), cpu_time::of_process_s());
        let todo: Vec<usize> = range.skip(before).collect();
        let work = |id: &usize| self.table.row(*id);
        let mut count = parallel::Count::new(&self.out.display().to_string(), todo.len());
        for stretch in todo.chunks(STRETCH.max(todo.len().div_ceil(200))) {
            let mut failed = None;
            parallel::run_part(&mut count, stretch, work, |line: &Result<String>| match line {
                Ok(line) if failed.is_none() => {
                    failed = writeln!(file, "{line}").err().map(anyhow::Error::from)
                }
                Ok(_) => {}
                Err(error) => failed = failed.take().or_else(|| Some(anyhow::anyhow!("{error:#}"))),
            });
            if let Some(error) = failed {
                return Err(error.context(format!("cannot go on with {}", self.out.display())));
            }
        }
        Ok(Ran {
            out: self.out.display().to_string(),
            now: todo.len(),
            before,
            wall_s: started.elapsed().as_secs_f64(),
            cpu_s: cpu_time::of_process_s() - cpu_before_s,
        })
    }

    /// Returns the file, ready for the next row, the number of rows that it holds, and the rows of this shard. A torn last
    /// line is cut off. The last row that it holds is computed anew and compared: a header says nothing of a seed.
    ///
    /// # Errors
    /// A file that cannot be written, that holds another header or other rows than this shard's from its start, or whose
    /// last row another campaign or another version made.
    pub fn open(&self) -> Result<(File, usize, Range<usize>)> {
        let (path, rows, (part, parts)) = (self.out, self.table.rows(), self.shard);
        let range = rows * (part - 1) / parts..rows * part / parts;
        let header = (part == 1).then(|| self.table.header());
        let context = || format!("cannot use {}", path.display());
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error).with_context(context),
        };
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        let done = held(path, whole, header.as_deref(), &range)?;
        if let Some(last) = done.checked_sub(1).map(|row| range.start + row) {
            ensure!(
                whole.lines().last() == Some(&self.table.row(last)?),
                "{}: row {last} is of another seed, plan or version: choose another file",
                path.display()
            );
        }
        let mut file =
            OpenOptions::new().create(true).truncate(false).write(true).open(path).with_context(context)?;
        file.set_len(whole.len() as u64).with_context(context)?;
        file.seek(SeekFrom::End(0)).with_context(context)?;
        if let (Some(header), true) = (header, whole.is_empty()) {
            writeln!(file, "{header}").with_context(context)?;
        }
        Ok((file, done, range))
    }
}

/// Number of rows in the text of a shard's file.
fn held(path: &Path, text: &str, header: Option<&str>, range: &Range<usize>) -> Result<usize> {
    let mut lines = text.lines();
    if let (Some(header), false) = (header, text.is_empty()) {
        ensure!(
            lines.next() == Some(header),
            "{} belongs to another campaign: its header differs",
            path.display()
        );
    }
    let mut done = 0;
    for line in lines {
        let expected = range.start + done;
        if number(line) != Some(expected) {
            let id = line.split(',').next().unwrap_or_default();
            bail!("{}: row '{id}' where run {expected} is expected", path.display());
        }
        done += 1;
    }
    ensure!(done <= range.len(), "{} holds more rows than this shard has runs", path.display());
    Ok(done)
}

/// `I/N` as the I-th of N parts.
pub fn shard(text: &str) -> Result<(usize, usize), String> {
    let parse = |part: &str| part.trim().parse::<usize>().ok();
    match text.split_once('/').map(|(i, n)| (parse(i), parse(n))) {
        Some((Some(i), Some(n))) if (1..=n).contains(&i) => Ok((i, n)),
        _ => Err(format!("'{text}' is not I/N with 1 <= I <= N")),
    }
}

/// Joins the files of all shards, given in any order, into `out`, which appears only when it is whole.
///
/// # Errors
/// A file that cannot be read, another header, a run that is missing or there twice: the message names run and file.
pub fn merge(parts: &[PathBuf], out: &Path, table: &dyn Table) -> Result<()> {
    let fresh = out.with_extension("joining");
    let joined = join(parts, &fresh, &table.header(), table.rows()).and_then(|()| {
        std::fs::rename(&fresh, out).with_context(|| format!("cannot write {}", out.display()))
    });
    if joined.is_err() {
        // The first error is the one to tell; a file that was never made is not there to remove.
        let _ = std::fs::remove_file(&fresh);
    }
    joined
}

fn join(parts: &[PathBuf], out: &Path, header: &str, rows: usize) -> Result<()> {
    let mut shards = Vec::new();
    for part in parts {
        let file = File::open(part).with_context(|| format!("cannot read {}", part.display()))?;
        let mut lines = BufReader::new(file).lines().peekable();
        if let Some(first) = lines.next_if(|line| line.as_ref().is_ok_and(|line| line.starts_with("run,"))) {
            ensure!(first? == header, "{} belongs to another campaign: its header differs", part.display());
        }
        let first = lines.peek().and_then(|line| line.as_ref().ok()).and_then(|line| number(line));
        shards.push((first, part, lines));
    }
    shards.sort_by_key(|(first, ..)| *first);
    let context = || format!("cannot write {}", out.display());
    let mut file = BufWriter::new(File::create(out).with_context(context)?);
    writeln!(file, "{header}").with_context(context)?;
    let mut next = 0;
    for (_, part, lines) in shards {
        for line in lines {
            let line = line.with_context(|| format!("cannot read {}", part.display()))?;
            match number(&line) {
                Some(run) if run == next => next += 1,
                Some(run) if run < next => bail!("{}: run {run} is there twice", part.display()),
                Some(run) => bail!("runs {next} to {} are missing before {}", run - 1, part.display()),
                None => bail!("{}: no run in the line after run {}", part.display(), next.saturating_sub(1)),
            }
            ensure!(
                line.matches(',').count() >= header.matches(',').count(),
                "{}: the line of run {} is torn: run its shard again",
                part.display(),
                next - 1
            );
            writeln!(file, "{line}").with_context(context)?;
        }
    }
    ensure!(next == rows, "runs {next} to {} are missing: run their shards again", rows.saturating_sub(1));
    file.into_inner().map_err(std::io::IntoInnerError::into_error).with_context(context)?;
    Ok(())
}

/// Number of the run whose row begins with `line`.
fn number(line: &str) -> Option<usize> {
    line.split(',').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table with a letter in each row.
    struct Letters(usize);

    impl Table for Letters {
        fn rows(&self) -> usize {
            self.0
        }

        fn header(&self) -> String {
            "run,a".into()
        }

        fn words(&self) -> Vec<&str> {
            vec!["a"]
        }

        fn row(&self, id: usize) -> Result<String> {
            Ok(format!("{id},x"))
        }
    }

    #[test]
    fn shard_is_one_of_those_there_are() {
        assert!(shard("0/3").is_err() && shard("4/3").is_err() && shard("2/3") == Ok((2, 3)));
    }

    #[test]
    fn file_goes_on_after_rows_of_its_own_campaign_alone() {
        let path = std::env::temp_dir().join(format!("moca-campaign-{:?}.csv", std::thread::current().id()));
        let opened = |held: &str, shard| {
            std::fs::write(&path, held)?;
            let (_, done, range) = Campaign { table: &Letters(4), out: &path, shard }.open()?;
            Ok::<_, anyhow::Error>((done, range, std::fs::read_to_string(&path)?))
        };
        let rows = "run,a\n0,x\n1,x\n".to_string();
        assert_eq!(opened("", (1, 1)).unwrap(), (0, 0..4, "run,a\n".into()));
        assert_eq!(
            opened(&format!("{rows}2,"), (1, 1)).unwrap(),
            (2, 0..4, rows.clone()),
            "a torn line is cut off"
        );
        assert_eq!(
            opened("2,x\n", (2, 2)).unwrap(),
            (1, 2..4, "2,x\n".into()),
            "the second shard has no header"
        );
        for (held, part) in [
            ("run,a\n0,x\n1,y\n", "row 1 is of another seed, plan or version"),
            ("run,b\n0,x\n", "its header differs"),
            ("run,a\n1,x\n", "row '1' where run 0 is expected"),
        ] {
            let error = format!("{:#}", opened(held, (1, 1)).unwrap_err());
            assert!(error.contains(part), "{error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), held, "nothing is lost");
        }
        std::fs::remove_file(&path).unwrap();
    }

    fn merged(parts: &[&str], rows: usize) -> Result<String> {
        let folder = std::env::temp_dir().join(format!("moca-merge-{:?}", std::thread::current().id()));
        std::fs::create_dir_all(&folder)?;
        let mut paths = Vec::new();
        for (i, part) in parts.iter().enumerate() {
            paths.push(folder.join(format!("{i}.csv")));
            std::fs::write(&paths[i], part)?;
        }
        let out = folder.join("out.csv");
        let joined = merge(&paths, &out, &Letters(rows)).and_then(|()| Ok(std::fs::read_to_string(&out)?));
        assert_eq!(std::fs::read_dir(&folder)?.count(), parts.len() + usize::from(joined.is_ok()));
        std::fs::remove_dir_all(&folder)?;
        joined
    }

    #[test]
    fn merge_joins_shards_in_any_order() {
        let whole = "run,a\n0,x\n1,x\n2,x\n";
        assert_eq!(merged(&["2,x\n", "run,a\n0,x\n", "1,x\n"], 3).unwrap(), whole);
        assert_eq!(merged(&[whole, ""], 3).unwrap(), whole);
    }

    #[test]
    fn merge_names_the_run_that_is_missing_or_double() {
        for (parts, part) in [
            (["run,a\n0,x\n", "2,x\n"], "runs 1 to 1 are missing before"),
            (["run,a\n0,x\n", "1,x\n"], "runs 2 to 2 are missing: run"),
            (["run,a\n0,x\n1,x\n", "1,x\n2,x\n"], "run 1 is there twice"),
            (["run,b\n0,x\n", "1,x\n2,x\n"], "header differs"),
            (["run,a\n0,x\n1,x\n", "2\n"], "run 2 is torn"),
        ] {
            let error = format!("{:#}", merged(&parts, 3).unwrap_err());
            assert!(error.contains(part), "{parts:?}: {error}");
        }
    }
}
