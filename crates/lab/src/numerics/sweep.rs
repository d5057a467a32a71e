//! `moca-lab sweep FILE`: many runs of one experiment over a grid or a random sample of its settings, one CSV row each.
//!
//! The list of runs follows from the file alone, so every shard knows all of them and takes a contiguous part: the
//! rows of any number of shards, joined in order, are those of one machine. No row holds a time, so no row depends on
//! the machine either.

use crate::campaign::Shards;
use crate::numerics::economy;
use anyhow::{Context, Result};
use moca_experiments::campaign::Table as _;
use moca_experiments::sweep::Sweep;
use moca_sim::{Engine, Scene};
use std::path::PathBuf;

/// Many collisions over a grid or a random sample of settings, resumable and in shards.
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
    #[command(flatten)]
    shards: Shards,
}

/// Runs what is missing of this shard.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let text = std::fs::read_to_string(&arguments.file)
        .with_context(|| format!("cannot read {}", arguments.file.display()))?;
    let sweep =
        Sweep::parse(&text, arguments.accuracy).with_context(|| format!("{}", arguments.file.display()))?;
    let Some(ran) = arguments.shards.run(&sweep, &arguments.out, &arguments.command()?)? else {
        return Ok(());
    };
    println!(
        "{:.1} runs per second of CPU; for the same simulated time bare mj_step of the same scene would allow {:.1}, the \
         bare step of its engine {:.1}\n{}",
        ran.per_cpu_s(),
        bare_runs_per_cpu_s(&sweep, Some(Engine::MuJoCo))?,
        bare_runs_per_cpu_s(&sweep, None)?,
        engines(&sweep)?,
    );
    Ok(())
}

impl Arguments {
    /// Words of this command that give the same rows in any folder.
    fn command(&self) -> Result<Vec<String>> {
        let file = std::path::absolute(&self.file)?;
        let mut words = vec!["sweep".to_owned(), file.to_str().context("a path is not UTF-8")?.to_owned()];
        if let Some(accuracy) = self.accuracy {
            words.extend(["--accuracy".to_owned(), accuracy.to_string()]);
        }
        Ok(words)
    }
}

/// Engines of the first and of the last run, with the reason for each.
fn engines(sweep: &Sweep) -> Result<String> {
    let [first, last] = [0, sweep.rows() - 1].map(|id| sweep.engine(&sweep.values(id)));
    let (first, last) = (first?, last?);
    Ok(if first == last { first } else { format!("first run: {first}\nlast run: {last}") })
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
        run(&Arguments { file, out: out.clone(), accuracy: None, shards: Shards::part(shard) }).unwrap();
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
