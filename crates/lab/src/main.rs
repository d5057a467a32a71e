//! `moca-lab`: experiments and checks on the command line.

mod campaign;
mod cover;
mod docs;
mod numerics;
mod paper;
mod picture;
mod robustness;
mod study;

use clap::{Parser, Subcommand};
use cover::{characterize, latency, stream, threshold};
use numerics::{economy, extremes, precision, stability, sweep, tick, vectors};
use paper::report;
use robustness::{attack, clients, faults, lean, long_lean, protection, recording, self_collision, soak};
use std::process::ExitCode;

/// Experiments and checks of MOCA-S.
#[derive(Parser)]
#[command(name = "moca-lab", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Show no progress bar.
    #[arg(long, global = true)]
    quiet: bool,
}

#[derive(Subcommand)]
enum Command {
    Attack(attack::Arguments),
    /// Ten trials of four foams: Tables I and II, Figure 4, what better calibrations gain.
    Characterize(characterize::Arguments),
    /// The paper's experiments, deterministic and faster than real time.
    Experiment(paper::Arguments),
    Docs(docs::Arguments),
    Extremes(extremes::Arguments),
    Faults(faults::Arguments),
    Lean(lean::Arguments),
    LongLean(long_lean::Arguments),
    /// From touch to force, stage by stage; whether the contact is stable and how fast the base may go.
    Latency(latency::Arguments),
    /// Prints the cost of observers to the live loop: overruns and publish stage with and without clients.
    Clients(clients::Arguments),
    /// Error against run time: integrators and steps, control rate, single precision.
    Precision(precision::Arguments),
    Protection(protection::Arguments),
    Recording(recording::Arguments),
    /// One self-contained HTML page: tables, figures, what matches the paper and what does not.
    Report(report::Arguments),
    /// The whole system at the stiff and extreme ends of its parameters.
    Stability(stability::Arguments),
    /// Many collisions over a grid or a random sample of settings, resumable and in shards.
    Sweep(sweep::Arguments),
    /// Prints the cost of a scene with everything in it and with only what it needs.
    Economy(economy::Arguments),
    SelfCollision(self_collision::Arguments),
    Soak(soak::Arguments),
    /// Reads a recorded Touch Board stream: frames, rate, faults.
    Stream(stream::Arguments),
    /// The smallest force that is felt and its delay; how little an untouched robot creeps.
    Threshold(threshold::Arguments),
    Tick(tick::Arguments),
    Vectors(vectors::Arguments),
}

fn main() -> ExitCode {
    moca_daemon::cli::terminal::end_with_the_reader();
    let arguments: Arguments = moca_manual::parse("moca-lab", &[]);
    if arguments.quiet {
        moca_daemon::cli::progress::be_quiet();
    }
    match run(arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            #[expect(clippy::print_stderr, reason = "the program's last words")]
            {
                eprintln!("moca-lab: {error:#}");
            }
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> anyhow::Result<()> {
    match command {
        Command::Attack(arguments) => attack::run(&arguments),
        Command::Characterize(arguments) => characterize::run(&arguments),
        Command::Experiment(arguments) => paper::run(&arguments),
        Command::Docs(arguments) => docs::run(&arguments),
        Command::Extremes(arguments) => extremes::run(&arguments),
        Command::Faults(arguments) => faults::run(&arguments),
        Command::Lean(arguments) => lean::run(&arguments),
        Command::LongLean(arguments) => long_lean::run(&arguments),
        Command::Latency(arguments) => latency::run(&arguments),
        Command::Clients(arguments) => clients::run(&arguments),
        Command::Precision(arguments) => precision::run(&arguments),
        Command::Protection(arguments) => protection::run(&arguments),
        Command::Recording(arguments) => recording::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Stability(arguments) => stability::run(&arguments),
        Command::Sweep(arguments) => sweep::run(&arguments),
        Command::Economy(arguments) => economy::run(&arguments),
        Command::SelfCollision(arguments) => self_collision::run(&arguments),
        Command::Soak(arguments) => soak::run(&arguments),
        Command::Stream(arguments) => stream::run(&arguments),
        Command::Threshold(arguments) => threshold::run(&arguments),
        Command::Tick(arguments) => tick::run(&arguments),
        Command::Vectors(arguments) => vectors::run(&arguments),
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn chapter_of_the_docs_is_what_the_command_line_says() {
        assert_eq!(moca_manual::check_chapter::<super::Arguments>("moca-lab"), Ok(()));
    }
}
