//! `mocad`: the daemon of MOCA-S.

use clap::{Args, Parser, Subcommand};
use moca_control::config::Config;
use moca_daemon::cli::terminal::Terminal;
use moca_daemon::runtime::allocations::CountingAllocator;
use moca_telemetry::log::LogError;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const EXIT_CODES: &str = "Exit codes: 0 ended as asked, 1 something failed, 2 wrong command line or configuration, or a file \
                          that is no log, 3 real time demanded and refused, 4 a running daemon refused the request, 5 the robot stopped \
                          while it was armed or tared, 6 the run ended in a fault, 7 the gripper holds nothing";

/// Tactile whole-body control of MOCA-S: without arguments, a simulated robot with a virtual Touch Board.
#[derive(Parser)]
#[command(name = "mocad", version = moca_daemon::VERSION, args_conflicts_with_subcommands = true, after_help = EXIT_CODES)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Show no progress bar.
    #[arg(long, global = true)]
    quiet: bool,
    #[command(flatten)]
    run: RunArguments,
}

#[derive(Subcommand)]
enum Command {
    /// Run the control loop (the default).
    Run(RunArguments),
    /// Press every taxel beside a reference force and write a calibration file.
    Calibrate(moca_daemon::cli::calibrate::Arguments),
    /// Say what is and is not real-time on this PC, beside an empty loop, and what to do about it.
    Doctor(moca_daemon::cli::doctor::Arguments),
    /// Run a log again from its recorded states and bytes, and compare every command bit for bit.
    Replay {
        /// A log that `mocad --record` wrote; of one that was split, its parts in order.
        #[arg(required = true)]
        log: Vec<PathBuf>,
    },
    Log(moca_daemon::cli::log::Arguments),
    Logs(moca_daemon::cli::log::ListArguments),
    /// List parameters, change them in a running daemon, or print their schema.
    #[command(subcommand)]
    Params(moca_daemon::cli::params::Command),
    /// Give programs of other machines certificates, list them, take them back (`telemetry.tls`).
    #[cfg(feature = "tls")]
    Access(moca_daemon::cli::access::Arguments),
    /// Print the default configuration with every field documented.
    DefaultConfig,
    #[command(flatten)]
    Operate(moca_daemon::cli::operate::Command),
    /// Print the robot as other programs read it.
    Describe(DescribeArguments),
}

#[derive(Args)]
struct DescribeArguments {
    /// As a URDF: base, taxels, arm and what it carries.
    #[arg(long, required = true)]
    urdf: bool,
    /// Configuration file (TOML); without one the built-in default.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

#[derive(Args)]
struct RunArguments {
    /// Configuration file (TOML); without one the built-in default runs.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Read this board instead of the configuration's: "avr" is the firmware itself in crates/firmware-sim.
    #[arg(long, value_name = "PORT")]
    board: Option<String>,
    /// Nobody presses the simulated robot: without the configuration's scripted hand.
    #[arg(long)]
    no_hand: bool,
    /// Only check the configuration and report every mistake in it.
    #[arg(long)]
    check: bool,
    /// End after this much robot time, s.
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Lock-step instead of real time: deterministic, the board's bytes in memory.
    #[arg(long)]
    as_fast_as_possible: bool,
    /// Write every command of a lock-step run as CSV.
    #[arg(long, value_name = "FILE", requires = "as_fast_as_possible")]
    command_log: Option<PathBuf>,
    /// Record every sample and every byte of the board as MCAP; the file must not exist yet.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Begin another file (FILE-2, FILE-3, …) after so much robot time, such as 10min, 90s or 2h.
    #[arg(long, value_name = "TIME", requires = "record", value_parser = time)]
    record_split: Option<std::time::Duration>,
    /// Let a fault strike a simulated robot; a wrong NAME lists all there are.
    #[arg(long, value_name = "NAME@SECONDS")]
    inject: Option<moca_lockstep::inject::Injection>,
    /// Importance of the lines that the terminal or the journal shows.
    #[arg(long, value_enum, default_value_t)]
    log_level: moca_daemon::cli::report::Level,
    /// End at once if the operating system refuses a setting of `[realtime]`.
    #[arg(long)]
    require_realtime: bool,
}

fn main() -> ExitCode {
    survive_large_files();
    let arguments: Arguments = moca_manual::parse("mocad", &moca_daemon::features());
    if arguments.quiet {
        moca_figures::progress::be_quiet();
    }
    if !matches!(arguments.command, None | Some(Command::Run(_))) {
        moca_daemon::cli::terminal::end_with_the_reader();
    }
    let result = match arguments.command {
        Some(Command::Operate(command)) => moca_daemon::cli::operate::run(&command),
        None => run(arguments.run),
        Some(Command::Run(run_arguments)) => run(run_arguments),
        Some(Command::Calibrate(calibrate)) => moca_daemon::cli::calibrate::run(&calibrate),
        Some(Command::Doctor(doctor)) => moca_daemon::cli::doctor::run(&doctor),
        Some(Command::Replay { log }) => replay(&log),
        Some(Command::Log(arguments)) => moca_daemon::cli::log::run(&arguments).map(|text| print(&text)),
        Some(Command::Logs(arguments)) => moca_daemon::cli::log::list(&arguments).map(|text| print(&text)),
        Some(Command::Params(command)) => moca_daemon::cli::params::run(&command),
        #[cfg(feature = "tls")]
        Some(Command::Access(arguments)) => {
            moca_daemon::cli::access::run(&arguments).map(|text| print(&text))
        }
        Some(Command::DefaultConfig) => {
            print(moca_control::config::DEFAULT_TOML);
            Ok(())
        }
        Some(Command::Describe(DescribeArguments { config, .. })) => describe(config.as_deref()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            moca_daemon::cli::terminal::last_words(&format!("{error:#}"));
            exit_code(&error)
        }
    }
}

/// A log that reaches the limit of a file's size is an error of that log; by default the signal would end the daemon, its robot
/// in motion.
fn survive_large_files() {
    use nix::sys::signal::{SigHandler, Signal, signal};
    #[expect(
        unsafe_code,
        reason = "a signal's disposition is set before any thread runs; ignoring runs no handler"
    )]
    // SAFETY: no handler is installed.
    let ignored = unsafe { signal(Signal::SIGXFSZ, SigHandler::SigIgn) };
    // The signal exists on every Linux.
    let _ = ignored;
}

/// The configuration has mistakes; the same code as for a mistake on the command line.
#[derive(Debug)]
struct WrongConfiguration(String);

impl std::fmt::Display for WrongConfiguration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for WrongConfiguration {}

fn exit_code(error: &anyhow::Error) -> ExitCode {
    let no_log = error.downcast_ref::<LogError>().is_some_and(LogError::is_of_no_log);
    if no_log || error.is::<WrongConfiguration>() {
        ExitCode::from(2)
    } else if error.is::<moca_daemon::runtime::run::RealtimeRefused>() {
        ExitCode::from(3)
    } else if error.is::<moca_daemon::cli::remote::Refused>() {
        ExitCode::from(4)
    } else if error.is::<moca_daemon::cli::operator::Stopped>() {
        ExitCode::from(5)
    } else if error.is::<moca_daemon::runtime::run::EndedInFault>() {
        ExitCode::from(6)
    } else if error.is::<moca_daemon::cli::gripper::HoldsNothing>() {
        ExitCode::from(7)
    } else {
        ExitCode::FAILURE
    }
}

fn time(text: &str) -> Result<std::time::Duration, String> {
    let units = [("min", 60.0), ("h", 3600.0), ("s", 1.0)];
    let seconds = units
        .iter()
        .find_map(|(unit, seconds)| Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * seconds));
    let allowed = "allowed: 10s to 1000h, such as 10min";
    let seconds = seconds.filter(|seconds| (10.0..=3.6e6).contains(seconds));
    seconds.map(std::time::Duration::from_secs_f64).ok_or_else(|| allowed.into())
}

fn replay(log: &[PathBuf]) -> anyhow::Result<()> {
    let mut progress = moca_figures::progress::Progress::new("replay");
    let report = moca_daemon::runtime::replay::run_watched(log, &mut |part| progress.at(part));
    progress.end();
    print(&report?.to_string());
    Ok(())
}

fn describe(config: Option<&Path>) -> anyhow::Result<()> {
    let config = configuration(config)?;
    print(&moca_control::config::urdf::urdf(&config.robot, config.plant.parts));
    Ok(())
}

#[expect(clippy::print_stdout, reason = "a command's result")]
fn print(text: &str) {
    print!("{text}");
}

/// Reads a configuration file, or takes the built-in one.
fn configuration(path: Option<&Path>) -> anyhow::Result<Config> {
    let Some(path) = path else { return Ok(Config::default()) };
    let config = Config::load(path);
    Ok(config.map_err(|error| WrongConfiguration(format!("{}:\n{error}", path.display())))?)
}

fn run(arguments: RunArguments) -> anyhow::Result<()> {
    let mut config = configuration(arguments.config.as_deref())?;
    if arguments.no_hand {
        config.simulation.hand = moca_control::config::HandConfig::none();
    }
    if let Some(port) = &arguments.board {
        config.board.port = port.as_str().into();
        let mut mistakes = Vec::new();
        config.check(|_, mistake| mistakes.push(mistake));
        if !mistakes.is_empty() {
            return Err(WrongConfiguration(mistakes.join("\n")).into());
        }
    }
    moca_control::assemble::cover_config(&config)
        .map_err(|error| WrongConfiguration(format!("{error:#}")))?;
    moca_control::assemble::motion(&config).map_err(|error| WrongConfiguration(format!("{error:#}")))?;
    moca_daemon::runtime::drivers::check_build(&config)
        .map_err(|error| WrongConfiguration(format!("{error:#}")))?;
    if arguments.check {
        let whose = arguments
            .config
            .as_ref()
            .map_or("the built-in configuration".into(), |path| path.display().to_string());
        print(&format!("{whose}: no mistakes, and this build can run it\n"));
        return Ok(());
    }
    let duration = arguments.duration.map(std::time::Duration::try_from_secs_f64);
    let duration = duration.transpose();
    let duration = duration.map_err(|error| anyhow::anyhow!("--duration: {error}; allowed: 0 s or more"))?;
    let mut terminal = Terminal::stdout(arguments.log_level, arguments.as_fast_as_possible)?;
    if let Some(duration) = duration.filter(|_| arguments.as_fast_as_possible) {
        terminal.show_progress(duration);
    }
    let options = moca_daemon::runtime::options::Options {
        config,
        duration,
        lock_step: arguments.as_fast_as_possible,
        command_log: arguments.command_log,
        record: arguments.record,
        record_split: arguments.record_split,
        inject: arguments.inject,
        require_realtime: arguments.require_realtime,
    };
    moca_daemon::runtime::run::run(&options, &mut terminal)
}

#[cfg(test)]
mod tests {
    #[test]
    fn chapter_of_the_docs_is_what_the_command_line_says() {
        assert_eq!(moca_manual::check_chapter::<super::Arguments>("mocad"), Ok(()));
    }
}
