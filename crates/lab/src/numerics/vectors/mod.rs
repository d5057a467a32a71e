//! `moca-lab vectors FILE`: prints the largest error of every quantity of a reference file.

use anyhow::{Context as _, bail};
use moca_wbc::testing::reference_file as compare;
use std::path::{Path, PathBuf};

/// Compares the controller crate with a file of reference configurations.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// File of the form of tests/fixtures/wbc.json.
    file: PathBuf,
}

/// Errs if any quantity is off by more than [`moca_wbc::testing::reference_file::TOLERANCE`].
#[expect(clippy::print_stdout, reason = "the answer of a command")]
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let errors = errors_of(&arguments.file)?;
    println!("{:32} largest error (max|a - ref| / max(max|ref|, 1))", "quantity");
    let mut worst: Option<(&str, f64)> = None;
    for (name, error) in &errors {
        match error {
            Some(error) if !compare::passes(*error) => println!("{name:32} {error:.1e}  FAILED"),
            Some(error) => println!("{name:32} {error:.1e}"),
            None => println!("{name:32} not checked"),
        }
        if let Some(error) = *error
            && worst.is_none_or(|(_, most)| error.total_cmp(&most).is_gt())
        {
            worst = Some((name, error));
        }
    }
    match worst {
        None => bail!("{}: nothing in the file could be checked", arguments.file.display()),
        Some((name, error)) if !compare::passes(error) => {
            bail!("{name} is off by {error:.1e}, more than {:.0e}", compare::TOLERANCE)
        }
        Some((name, error)) => {
            println!("all within {:.0e}; largest {error:.1e} ({name})", compare::TOLERANCE);
            Ok(())
        }
    }
}

fn errors_of(file: &Path) -> anyhow::Result<compare::Errors> {
    let text = std::fs::read_to_string(file).with_context(|| format!("reading {}", file.display()))?;
    let document = serde_json::from_str(&text).with_context(|| format!("{} is not JSON", file.display()))?;
    compare::compare(&document).map_err(anyhow::Error::msg).with_context(|| file.display().to_string())
}
