//! `moca-lab sweep FILE`: many runs of one experiment over a grid or a random sample of its settings, one CSV row each.
//!
//! The list of runs follows from the file alone, so every shard knows all of them and takes a contiguous part: the
//! rows of any number of shards, joined in order, are those of one machine. No row holds a time, so no row depends on
//! the machine either.

use crate::numerics::{economy, slurm};
use anyhow::{Context, Result};
use moca_experiments::campaign::{self, Campaign};
use moca_experiments::sweep::Sweep;
use moca_sim::{Engine, Scene};
use std::path::PathBuf;

/// Arguments of `moca-lab sweep`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Plan of the sweep: see scenes/sweep.toml.
    file: PathBuf,
    /// CSV file; rows that are already in it are kept and not run again.
    #[arg(long, value_name = "CSV")]
    out: PathBuf,
    /// Error of a tick, over 25 N and 15 mm, for which physics steps are chosen in every run, e.g. 1e-3.
    #[arg(long)]
    accuracy: Option<f64>,
    /// Part of the runs, e.g. 2/8 for the second of eight; joined in order the parts are the whole.
    #[arg(long, value_name = "I/N", value_parser = campaign::shard, default_value = "1/1")]
    shard: (usize, usize),
    /// Submits the runs to Slurm as an array of N tasks, and a task that joins their files into the CSV file.
    #[arg(long, value_name = "N", conflicts_with = "shard", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    slurm: Option<u32>,
    /// Joins files of all shards, in any order, into the CSV file; refuses a run that is missing or there twice.
    #[arg(long, value_name = "CSV", num_args = 1.., conflicts_with_all = ["shard", "slurm"])]
    merge: Vec<PathBuf>,
}

/// Runs what is missing of this shard.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let text = std::fs::read_to_string(&arguments.file)
        .with_context(|| format!("cannot read {}", arguments.file.display()))?;
    let sweep =
        Sweep::parse(&text, arguments.accuracy).with_context(|| format!("{}", arguments.file.display()))?;
    if !arguments.merge.is_empty() {
        return campaign::merge(&arguments.merge, &arguments.out, &sweep.header(), sweep.runs());
    }
    if let Some(tasks) = arguments.slurm {
        let (array, join) = slurm::submit(&arguments.file, &arguments.out, arguments.accuracy, tasks)?;
        println!(
            "{}: array {array} of {tasks} tasks, then {join} joins them: squeue",
            arguments.out.display()
        );
        return Ok(());
    }
    let campaign =
        Campaign { out: &arguments.out, shard: arguments.shard, rows: sweep.runs(), header: &sweep.header() };
    let ran = campaign.run(|id| sweep.row(id))?;
    println!("{ran}");
    println!(
        "{:.1} runs per second of CPU; for the same simulated time bare mj_step of the same scene would allow {:.1}, the \
         bare step of its engine {:.1}\n{}",
        ran.per_cpu_s(),
        bare_runs_per_cpu_s(&sweep, Some(Engine::MuJoCo))?,
        bare_runs_per_cpu_s(&sweep, None)?,
        sweep.settings(&sweep.values(0))?.engine.reason(),
    );
    Ok(())
}

/// Runs per second of CPU time if a run were nothing but steps of this engine, or of the plan's.
fn bare_runs_per_cpu_s(sweep: &Sweep, engine: Option<Engine>) -> Result<f64> {
    let settings = sweep.settings(&sweep.values(0))?;
    let scene = settings.collision_scene()?;
    let scene = Scene { engine: engine.unwrap_or(scene.engine), ..scene };
    let step_s = 1e-6 * economy::bare_step_us(&scene)?;
    Ok(settings.step_ms / (1e3 * settings.duration_s * step_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const PLAN: &str = "[set]\nduration = 0.6\n\"person.gap\" = 0.001\nspeed = 0.25\n[grid]\nd_v = [40, 80]\n\
                        m_v = [2, 4]\n[random]\nsamples = 2\nseed = 5\n[random.log]\n\"person.mass\" = [10, 100]\n";

    fn sweep(folder: &Path, name: &str, shard: (usize, usize)) -> String {
        let file = folder.join("plan.toml");
        std::fs::write(&file, PLAN).unwrap();
        let out = folder.join(name);
        run(&Arguments { file, out: out.clone(), accuracy: None, shard, slurm: None, merge: Vec::new() })
            .unwrap();
        std::fs::read_to_string(out).unwrap()
    }

    #[test]
    fn shards_joined_are_the_whole_and_an_interrupted_run_goes_on() {
        let folder = std::env::temp_dir().join(format!("moca-sweep-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let whole = sweep(&folder, "whole.csv", (1, 1));
        assert_eq!(whole.lines().count(), 9);
        let joined: String = (1..=3).map(|i| sweep(&folder, &format!("{i}.csv"), (i, 3))).collect();
        assert_eq!(joined, whole);
        // Cut within the fifth row, as a killed process leaves it.
        let cut = whole.match_indices('\n').nth(4).unwrap().0 + 12;
        std::fs::write(folder.join("cut.csv"), &whole[..cut]).unwrap();
        assert_eq!(sweep(&folder, "cut.csv", (1, 1)), whole);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
