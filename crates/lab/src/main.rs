//! `moca-lab`: experiments and checks on the command line.

mod experiment;
mod stream;
mod tick;
mod vectors;

use clap::{Parser, Subcommand};

/// Experiments and checks of MOCA-S.
#[derive(Parser)]
#[command(name = "moca-lab")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// The paper's experiments, deterministic and faster than real time.
    Experiment(experiment::Arguments),
    /// Reads a recorded Touch Board stream: frames, rate, faults.
    Stream(stream::Arguments),
    Tick(tick::Arguments),
    Vectors(vectors::Arguments),
}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().command {
        Command::Experiment(arguments) => experiment::run(&arguments),
        Command::Stream(arguments) => stream::run(&arguments),
        Command::Tick(arguments) => tick::run(&arguments),
        Command::Vectors(arguments) => vectors::run(&arguments),
    }
}
