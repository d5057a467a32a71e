//! A campaign as an array of Slurm tasks and a task that joins their files.

use anyhow::{Context, Result, ensure};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Submits both and returns their numbers. `words` after `moca-lab` name the campaign, paths in them absolute.
///
/// A task that is started again after its node was lost writes a file of its own: the old one may live on behind a cut
/// cable. Its last name says that it is whole.
///
/// # Errors
/// A path that is no text, a folder that cannot be made, `sbatch` that is not there or refuses.
pub(super) fn submit(words: &[String], out: &Path, tasks: u32) -> Result<(String, String)> {
    let parts = PathBuf::from(format!("{}.parts", out.display()));
    std::fs::create_dir_all(&parts).with_context(|| format!("cannot make {}", parts.display()))?;
    let absolute = |path: &Path| -> Result<String> {
        Ok(quoted(std::path::absolute(path)?.to_str().context("a path is not UTF-8")?))
    };
    let lab = absolute(&std::env::current_exe()?)?;
    let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    let campaign = format!("{lab} --quiet {} --out", words.join(" "));
    let (folder, whole) = (absolute(&parts)?, absolute(out)?);
    let shard = format!(
        "set -eu; part={folder}/$SLURM_ARRAY_TASK_ID; own=$part.${{SLURM_RESTART_COUNT:-0}}.tmp; \
         {campaign} \"$own\" --shard $SLURM_ARRAY_TASK_ID/{tasks}; mv \"$own\" \"$part.csv\""
    );
    let array = format!("--array=1-{tasks}");
    let log = parts.join("%a.log");
    let array = sbatch(&[&array, "--requeue", "--cpus-per-task=1"], &log, &shard)?;
    let join = format!("{campaign} {whole} --merge {folder}/*.csv");
    let dependency = format!("--dependency=afterok:{array}");
    let join = sbatch(&[&dependency, "--kill-on-invalid-dep=yes"], &parts.join("join.log"), &join)?;
    Ok((array, join))
}

/// Text as one word of a shell.
fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', "'\\''"))
}

fn sbatch(options: &[&str], log: &Path, script: &str) -> Result<String> {
    let mut command = Command::new("sbatch");
    command.arg("--parsable").args(options).arg("--output").arg(log).args(["--wrap", script]);
    let output =
        command.stderr(Stdio::inherit()).output().context("cannot start sbatch: is this a node of Slurm?")?;
    ensure!(output.status.success(), "sbatch refused: {}", output.status);
    // With several clusters the number is followed by the cluster's name.
    let said = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    Ok(said.split(';').next().unwrap_or_default().to_owned())
}

#[cfg(test)]
#[test]
fn quoted_path_is_one_word_of_a_shell() {
    let path = "a b'c$(d)";
    let echoed = Command::new("sh").arg("-c").arg(format!("printf %s {}", quoted(path))).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&echoed.stdout), path);
}
