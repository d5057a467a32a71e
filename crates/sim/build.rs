//! Puts MuJoCo's shared library where cargo, the linker and a program started by hand find it.
//!
//! By default the library comes from the PyPI wheel (`fetch_mujoco.py`, once, into the git-ignored `third_party/`).
//! A `MUJOCO_DYNAMIC_LINK_DIR` of the user's own wins, and nothing is downloaded.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::{env, fs, io};

const LIBRARY: &str = "libmujoco.so.3.17.0";
const LINK_DIR: &str = "MUJOCO_DYNAMIC_LINK_DIR";

fn main() -> ExitCode {
    match link_mujoco() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!(
                "\nThe simulation needs MuJoCo 3.17.0: {error}\n\n\
                 Either set {LINK_DIR} to the absolute path of a folder that holds libmujoco.so of MuJoCo 3.17.0,\n\
                 or build without the simulation:\n    \
                 cargo run --release -p moca-daemon --bin mocad --no-default-features --features board\n"
            );
            ExitCode::FAILURE
        }
    }
}

fn link_mujoco() -> Result<(), String> {
    println!("cargo::rerun-if-env-changed={LINK_DIR}");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=fetch_mujoco.py");
    let crate_dir = path_variable("CARGO_MANIFEST_DIR")?;
    let out_dir = path_variable("OUT_DIR")?;
    let library = match env::var_os(LINK_DIR).map(PathBuf::from) {
        Some(dir) if !is_same_dir(&dir, &crate_dir.join("mujoco")) => user_library(&dir)?,
        _ => fetched_library(&crate_dir)?,
    };
    println!("cargo::rerun-if-changed={}", library.display());

    // Inside OUT_DIR, so that cargo puts it on the library path of run, test and doctest.
    place(&library, &out_dir.join(LIBRARY))?;
    println!("cargo::rustc-link-search=native={}", out_dir.display());
    // Beside the binaries (OUT_DIR is <target>/<profile>/build/<package>/out), for the $ORIGIN run path.
    if let Some(profile_dir) = out_dir.ancestors().nth(3) {
        place(&library, &profile_dir.join(LIBRARY))?;
    }
    Ok(())
}

fn path_variable(name: &str) -> Result<PathBuf, String> {
    env::var_os(name).map(PathBuf::from).ok_or_else(|| format!("cargo did not set {name}"))
}

fn is_same_dir(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

fn user_library(dir: &Path) -> Result<PathBuf, String> {
    [LIBRARY, "libmujoco.so"]
        .iter()
        .find_map(|name| dir.join(name).canonicalize().ok())
        .ok_or_else(|| format!("{LINK_DIR} = '{}' holds neither {LIBRARY} nor libmujoco.so", dir.display()))
}

fn fetched_library(crate_dir: &Path) -> Result<PathBuf, String> {
    let target = (env::var("CARGO_CFG_TARGET_ARCH"), env::var("CARGO_CFG_TARGET_OS"));
    if target != (Ok("x86_64".into()), Ok("linux".into())) {
        return Err("the build fetches the library for x86-64 Linux only".into());
    }
    let folder = crate_dir.join("../../third_party/mujoco-3.17.0");
    let library = folder.join(LIBRARY);
    if !library.is_file() {
        let script = crate_dir.join("fetch_mujoco.py");
        let output = Command::new("python3")
            .arg(&script)
            .arg(&folder)
            .output()
            .map_err(|error| format!("python3 cannot be started ({error})"))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(format!("the download failed:\n{}", said.trim()));
        }
    }
    library.canonicalize().map_err(|error| format!("'{}': {error}", library.display()))
}

/// Hard link, or a copy across file systems; an existing link to the same file is left alone.
fn place(library: &Path, link: &Path) -> Result<(), String> {
    let failed = |error: io::Error| format!("'{}': {error}", link.display());
    // A name of this process, renamed into place: a program that runs from the old file keeps it.
    let fresh = link.with_extension(format!("{}.tmp", std::process::id()));
    if fs::hard_link(library, &fresh).is_err() {
        fs::copy(library, &fresh).map_err(failed)?;
    }
    fs::rename(&fresh, link).map_err(failed)?;
    // Renaming one hard link onto another of the same file does nothing and leaves both.
    match fs::remove_file(&fresh) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(failed(error)),
        _ => Ok(()),
    }
}
