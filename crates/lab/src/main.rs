//! `moca-lab`: experiments and checks on the command line.

use clap::{Parser, Subcommand};

/// Experiments and checks of MOCA-S.
#[derive(Parser)]
#[command(name = "moca-lab")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {}

fn main() -> anyhow::Result<()> {
    match Arguments::parse().command {}
}
