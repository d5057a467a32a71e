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

/// Declares the commands, each with the module that has its `Arguments` and runs it.
macro_rules! commands {
    ($($command:ident: $($module:ident)::+,)+) => {
        #[derive(Subcommand)]
        enum Command {
            $($command($($module)::+::Arguments),)+
        }

        fn run(command: &Command) -> anyhow::Result<()> {
            match command {
                $(Command::$command(arguments) => $($module)::+::run(arguments),)+
            }
        }
    };
}

commands! {
    Attack: robustness::attack,
    Bench: numerics::bench,
    Characterize: cover::characterize,
    Experiment: paper,
    Docs: docs,
    Extremes: numerics::extremes,
    Faults: robustness::faults,
    Lean: robustness::lean,
    LongLean: robustness::long_lean,
    Latency: cover::latency,
    Clients: robustness::clients,
    Precision: numerics::precision,
    Protection: robustness::protection,
    Recording: robustness::recording,
    Report: paper::report,
    Stability: numerics::stability,
    Sweep: numerics::sweep,
    Economy: numerics::economy,
    SelfCollision: robustness::self_collision,
    Soak: robustness::soak,
    Stream: cover::stream,
    Threshold: cover::threshold,
    Tick: numerics::tick,
    Vectors: numerics::vectors,
}

fn main() -> ExitCode {
    moca_daemon::cli::terminal::end_with_the_reader();
    let arguments: Arguments = moca_manual::parse("moca-lab", &[]);
    if arguments.quiet {
        moca_figures::progress::be_quiet();
    }
    match run(&arguments.command) {
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

#[cfg(test)]
mod tests {
    #[test]
    fn chapter_of_the_docs_is_what_the_command_line_says() {
        assert_eq!(moca_manual::check_chapter::<super::Arguments>("moca-lab"), Ok(()));
    }
}
