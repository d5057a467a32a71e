//! `moca-lab sweep --slurm` with an `sbatch` that runs its tasks here and now.
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

fn lab(folder: &Path, arguments: &[&str]) -> bool {
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_moca-lab"));
    command.current_dir(folder).env("PATH", path).args(["--quiet", "sweep", "plan.toml"]).args(arguments);
    command.status().unwrap().success()
}

#[test]
fn array_and_join_give_the_bytes_of_one_machine() {
    let folder = std::env::temp_dir().join(format!("moca slurm {}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("plan.toml"), PLAN).unwrap();
    std::fs::write(folder.join("sbatch"), SBATCH).unwrap();
    std::fs::set_permissions(folder.join("sbatch"), std::fs::Permissions::from_mode(0o755)).unwrap();
    assert!(lab(&folder, &["--out", "alone.csv"]));
    assert!(lab(&folder, &["--out", "joined.csv", "--slurm", "4"]));
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    assert_eq!(read("joined.csv"), read("alone.csv"));
    std::fs::remove_file(folder.join("joined.csv.parts/3.csv")).unwrap();
    let left = ["1", "2", "4"].map(|part| format!("joined.csv.parts/{part}.csv"));
    let [a, b, c] = left.each_ref().map(String::as_str);
    assert!(!lab(&folder, &["--out", "gap.csv", "--merge", a, b, c]) && !folder.join("gap.csv").exists());
    std::fs::remove_dir_all(&folder).unwrap();
}
