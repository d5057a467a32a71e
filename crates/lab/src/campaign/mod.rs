//! Arguments of every campaign: the part of its rows that this process makes, or who else makes and joins them.

mod slurm;

use anyhow::Result;
use moca_experiments::campaign::{self, Campaign, Ran, Table};
use std::path::{Path, PathBuf};

/// Part of a campaign. The command has an argument `out` besides.
#[derive(clap::Args)]
pub(crate) struct Shards {
    /// Part of the runs, e.g. 2/8 for the second of eight; joined in order the parts are the whole.
    #[arg(long, value_name = "I/N", value_parser = campaign::shard, default_value = "1/1")]
    shard: (usize, usize),
    /// Submits the runs to Slurm as an array of N tasks, and a task that joins their files into the CSV file.
    #[arg(long, value_name = "N", requires = "out", conflicts_with = "shard", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    slurm: Option<u32>,
    /// Joins files of all shards, in any order, into the CSV file; refuses a run that is missing or there twice.
    #[arg(long, value_name = "CSV", num_args = 1.., requires = "out", conflicts_with_all = ["shard", "slurm"])]
    merge: Vec<PathBuf>,
}

impl Shards {
    /// Runs what is missing of this shard of `table` and returns its cost, or submits or joins shards. `command` has the words
    /// after `moca-lab` that give the same table anywhere.
    #[expect(clippy::print_stdout, reason = "the command's output")]
    pub(crate) fn run(&self, table: &dyn Table, out: &Path, command: &[String]) -> Result<Option<Ran>> {
        if !self.merge.is_empty() {
            campaign::merge(&self.merge, out, table)?;
            return Ok(None);
        }
        if let Some(tasks) = self.slurm {
            let (array, join) = slurm::submit(command, out, tasks)?;
            println!("{}: array {array} of {tasks} tasks, then {join} joins them: squeue", out.display());
            return Ok(None);
        }
        let ran = Campaign { table, out, shard: self.shard }.run()?;
        println!("{ran}");
        Ok(Some(ran))
    }
}

#[cfg(test)]
impl Shards {
    /// One of the parts.
    pub(crate) const fn part(shard: (usize, usize)) -> Self {
        Self { shard, slurm: None, merge: Vec::new() }
    }
}
