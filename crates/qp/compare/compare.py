#!/usr/bin/env python3
"""Times of this crate beside qpmad, eiquadprog and DAQP on the same problems, problem by problem in turn, and one judge for all.

usage: crates/qp/compare/compare.py [--library]

Prepares them in target/qp-peers, once: eiquadprog and Eigen from PyPI, DAQP from its source there, qpmad from GitHub (QPMAD: a folder
of its repository that is there already). All are compiled for this processor; this crate is what `cargo bench` makes of it.
Needs g++, pip and git. --library only builds, and prints the library's path.
"""
import os
import pathlib
import subprocess
import sys
import tarfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
FOLDER = ROOT / "target/qp-peers"
DAQP, QPMAD = "0.11.0", "1.4.0"
FLAGS = ["-O3", "-march=native", "-DNDEBUG", "-fPIC", "-w"]


def run(*words, **options):
    subprocess.run([str(word) for word in words], check=True, stdout=sys.stderr, **options)


def fetched():
    """The sources of the others, and the prefix of eiquadprog and Eigen."""
    python, daqp = FOLDER / "venv/bin/python", FOLDER / f"daqp-{DAQP}"
    pip = [python, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    if not (FOLDER / "complete").exists():
        run(sys.executable, "-m", "venv", FOLDER / "venv")
        run(*pip, "install", "eiquadprog==1.3.2", "cmeel-eigen")
        run(*pip, "download", "--no-deps", "--no-binary", ":all:", f"daqp=={DAQP}", "--dest", FOLDER)
        with tarfile.open(FOLDER / f"daqp-{DAQP}.tar.gz") as archive:
            archive.extractall(FOLDER, filter="data")
        (FOLDER / "complete").touch()
    qpmad = pathlib.Path(os.environ.get("QPMAD", FOLDER / "qpmad"))
    if not qpmad.exists():
        run("git", "clone", "--quiet", "--depth", "1", "--branch", QPMAD, "https://github.com/asherikov/qpmad", qpmad)
    (FOLDER / "include/qpmad").mkdir(parents=True, exist_ok=True)
    (FOLDER / "include/qpmad/config.h").touch()
    prefix = next((FOLDER / "venv/lib").glob("python3*/site-packages/cmeel.prefix"))
    return daqp / "csrc", qpmad / "include", prefix


def library():
    path = FOLDER / "libpeers.so"
    if path.exists() and path.stat().st_mtime > (HERE / "peers.cpp").stat().st_mtime:
        return path
    FOLDER.mkdir(parents=True, exist_ok=True)
    daqp, qpmad, prefix = fetched()
    objects = []
    for source in sorted((daqp / "src").glob("*.c")):
        objects.append(FOLDER / f"daqp-{source.stem}.o")
        run(os.environ.get("CC", "gcc"), *FLAGS, f"-I{daqp}/include", "-c", source, "-o", objects[-1])
    includes = [daqp / "include", qpmad, FOLDER / "include/qpmad", prefix / "include", prefix / "include/eigen3"]
    run(os.environ.get("CXX", "g++"), "-std=c++17", *FLAGS, "-shared", HERE / "peers.cpp", *objects, "-o", path,
        *(f"-I{folder}" for folder in includes), f"-L{prefix}/lib", "-leiquadprog", f"-Wl,-rpath,{prefix}/lib")
    return path


if __name__ == "__main__":
    if "--library" in sys.argv:
        print(library())
    else:
        subprocess.run(["cargo", "bench", "--quiet", "-p", "moca-qp", "--bench", "compare", "--", library()], cwd=ROOT, check=True)
