//! Puts MuJoCo's library into the package, where the extension's run path ($ORIGIN) finds it.

use std::path::Path;
use std::process::{Command, ExitCode};
use std::{env, fs};

const LIBRARY: &str = "libmujoco.so.3.17.0";

fn main() -> ExitCode {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN");
    let folder = env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(Into::into);
    let folder: std::path::PathBuf = folder
        .filter(|folder: &std::path::PathBuf| folder.join(LIBRARY).is_file())
        .unwrap_or_else(|| "../third_party/mujoco-3.17.0".into());
    if !folder.join(LIBRARY).is_file() {
        let script = Path::new("../crates/sim/fetch_mujoco.py");
        let fetched = Command::new("python3").arg(script).arg(&folder).status();
        if !fetched.is_ok_and(|status| status.success()) {
            eprintln!("the package needs {LIBRARY}: set MUJOCO_DYNAMIC_LINK_DIR to a folder that holds it");
            return ExitCode::FAILURE;
        }
    }
    match fs::copy(folder.join(LIBRARY), Path::new("moca").join(LIBRARY)) {
        Ok(_) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{}: {error}", folder.join(LIBRARY).display());
            ExitCode::FAILURE
        }
    }
}
