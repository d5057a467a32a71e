//! Cost of a step on any machine: instructions, and the bytes of code and data it touches.
//!
//! Nothing is timed. `valgrind --tool=lackey` writes down every access of a program that calls [`marked`]; what lies
//! between the marks is counted. A step of which a cold cache has to fetch every byte pays for the bytes, a hot one for the
//! instructions.

use super::steps::{Case, Steps};
use std::boxed::Box;
use std::collections::BTreeSet;
use std::error::Error;
use std::format;
use std::fs::File;
use std::hint::black_box;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, ExitStatus};
use std::string::{String, ToString as _};

/// Bytes of a line of the caches.
const LINE: u64 = 64;

/// Footprint of one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Footprint {
    /// Mean over the robots.
    pub instructions: u64,
    /// Bytes of the instructions that any of the robots' steps ran.
    pub code_bytes: u64,
    /// In lines of 64 bytes, each counted whole.
    pub code_lines_bytes: u64,
    /// Bytes that a step reads or writes, stack included: the most of any robot.
    pub data_lines_bytes: u64,
}

#[inline(never)]
fn begin() {
    black_box(0_u8);
}

#[inline(never)]
fn end() {
    black_box(1_u8);
}

/// Runs a step of each robot between marks; prints where the marks are. What [`measured`] starts under valgrind ends here.
///
/// # Errors
/// As [`Steps::step`].
pub fn marked(case: Case) -> Result<(), Box<dyn Error>> {
    // The first thread's stack begins behind the environment, and which lines it shares with what lies there differs from
    // one environment to the next; another thread's begins at a page.
    let run = std::thread::spawn(move || steps_between_marks(case).map_err(|error| error.to_string()));
    Ok(run.join().map_err(|_| "the step panicked")??)
}

#[expect(clippy::print_stdout, reason = "the answer to who has started it")]
fn steps_between_marks(case: Case) -> Result<(), Box<dyn Error>> {
    let mut steps = Steps::new(case)?;
    std::println!("{:x} {:x}", begin as fn() as usize, end as fn() as usize);
    for robot in 0..Steps::ROBOTS {
        begin();
        let output = steps.step(robot);
        end();
        black_box(output?);
    }
    Ok(())
}

/// The footprint of a step of `command`, a program that calls [`marked`]; `None` where valgrind is not installed.
///
/// # Errors
/// A program that fails, or a trace without marks.
pub fn measured(command: &Path, arguments: &[&str]) -> Result<Option<Footprint>, Box<dyn Error>> {
    if Command::new("valgrind").arg("--version").output().is_err() {
        return Ok(None);
    }
    let trace = std::env::temp_dir().join(format!("moca-footprint-{}", std::process::id()));
    let done = Command::new("valgrind")
        .args(["--tool=lackey", "--trace-mem=yes", &format!("--log-file={}", trace.display())])
        .arg(command)
        .args(arguments)
        .output()?;
    let counted = if done.status.success() {
        counted(&String::from_utf8(done.stdout)?, &trace)
    } else {
        Err(reason(done.status, &String::from_utf8_lossy(&done.stderr), &trace).into())
    };
    let _ = std::fs::remove_file(&trace);
    counted.map(Some)
}

/// Why a program failed under valgrind: what it said, and what valgrind could not run. A valgrind older than the compiler
/// lacks an instruction now and then.
fn reason(status: ExitStatus, said: &str, trace: &Path) -> String {
    let mut reason = format!("under valgrind the program ended with {status}");
    let unknown = File::open(trace).ok().and_then(|trace| {
        BufReader::new(trace)
            .lines()
            .map_while(Result::ok)
            .find(|line| line.contains("unhandled instruction bytes"))
    });
    for part in [said.trim(), &unknown.unwrap_or_default()].into_iter().filter(|part| !part.is_empty()) {
        reason.push_str(": ");
        reason.push_str(part);
    }
    reason
}

fn counted(marks: &str, trace: &Path) -> Result<Footprint, Box<dyn Error>> {
    let mut marks = marks.split_whitespace().map(|mark| u64::from_str_radix(mark, 16));
    let (Some(Ok(begin)), Some(Ok(end))) = (marks.next(), marks.next()) else {
        return Err("the program said nothing of its marks".into());
    };
    let (mut between, mut steps, mut instructions) = (false, 0, 0);
    let (mut code, mut code_lines, mut data_lines) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    let mut most_data_lines = 0;
    for line in BufReader::new(File::open(trace)?).lines() {
        let line = line?;
        let (kind, access) = line.split_at(line.len().min(3));
        let Some((address, size)) = access.trim().split_once(',') else { continue };
        let (Ok(address), Ok(size)) = (u64::from_str_radix(address, 16), size.parse::<u64>()) else {
            continue;
        };
        let lines = (address / LINE)..=((address + size - 1) / LINE);
        match kind {
            "I  " if address == begin => between = true,
            "I  " if address == end => {
                between = false;
                steps += 1;
                most_data_lines = most_data_lines.max(data_lines.len());
                data_lines.clear();
            }
            "I  " if between => {
                instructions += 1;
                code.extend(address..address + size);
                code_lines.extend(lines);
            }
            " L " | " S " | " M " if between => data_lines.extend(lines),
            _ => {}
        }
    }
    if steps == 0 {
        return Err("the trace has no marks".into());
    }
    let bytes = |lines: usize| LINE * lines as u64;
    Ok(Footprint {
        instructions: instructions / steps,
        code_bytes: code.len() as u64,
        code_lines_bytes: bytes(code_lines.len()),
        data_lines_bytes: bytes(most_data_lines),
    })
}
