//! Campaigns of `moca-lab` with `--slurm` and an `sbatch` that runs its tasks here and now.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its input has to stop")]

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::Command;

const PLAN: &str = "[set]\nduration = 0.3\n\"person.gap\" = 0.001\nengine = \"analytic\"\n[grid]\nd_v = [40, 80]\nm_v = [2, 4, 8]\n";
/// Runs an array's tasks one after the other, the second one twice, as after the loss of its node.
const SBATCH: &str = r#"#!/bin/sh
for word; do
    case "$word" in --array=1-*) tasks=${word#--array=1-} ;; esac
    script=$word
done
for SLURM_ARRAY_TASK_ID in $(seq "${tasks:-1}"); do
    export SLURM_ARRAY_TASK_ID
    sh -c "$script" >&2 || exit 1
    [ "$SLURM_ARRAY_TASK_ID" != 2 ] || SLURM_RESTART_COUNT=1 sh -c "$script" >&2 || exit 1
done
echo "42;here"
"#;

fn lab(folder: &Path, words: &[&[&str]]) -> bool {
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_moca-lab"));
    command.current_dir(folder).env("PATH", path).arg("--quiet").args(words.concat());
    command.status().unwrap().success()
}

/// Runs a campaign at once, as an array of four tasks, and resumed; then joins it with a part missing and one there twice.
fn array_and_join_give_the_bytes_of_one_machine(name: &str, campaign: &[&str]) {
    let folder = std::env::temp_dir().join(format!("moca slurm {name} {}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("plan.toml"), PLAN).unwrap();
    std::fs::write(folder.join("sbatch"), SBATCH).unwrap();
    std::fs::set_permissions(folder.join("sbatch"), std::fs::Permissions::from_mode(0o755)).unwrap();
    assert!(lab(&folder, &[campaign, &["--out", "alone.csv"]]));
    assert!(lab(&folder, &[campaign, &["--out", "joined.csv", "--slurm", "4"]]));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let whole = read("alone.csv");
    assert_eq!(read("joined.csv"), whole);
    // Cut within the third row, as a killed process leaves it.
    let cut = whole.match_indices('\n').nth(2).unwrap().0 + 12;
    std::fs::write(folder.join("cut.csv"), &whole[..cut]).unwrap();
    assert!(lab(&folder, &[campaign, &["--out", "cut.csv"]]));
    assert_eq!(read("cut.csv"), whole);
    let [a, b, c, d] = ["1", "2", "3", "4"].map(|part| format!("joined.csv.parts/{part}.csv"));
    for parts in [&[&*a, &b, &d][..], &[&*a, &b, &c, &b, &d]] {
        assert!(!lab(&folder, &[campaign, &["--out", "wrong.csv", "--merge"], parts]));
        assert!(!folder.join("wrong.csv").exists());
    }
    assert!(lab(&folder, &[campaign, &["--out", "right.csv", "--merge"], &[&*d, &b, &c, &a]]));
    assert_eq!(read("right.csv"), whole);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn sweep_as_an_array_gives_the_bytes_of_one_machine() {
    array_and_join_give_the_bytes_of_one_machine("sweep", &["sweep", "plan.toml"]);
}

#[test]
fn drawn_meetings_as_an_array_give_the_bytes_of_one_machine() {
    array_and_join_give_the_bytes_of_one_machine("drawn", &["protection", "--random", "6", "--seed", "5"]);
}
