"""Runs the experiments on a second engine and writes what they did.

usage: python -m peers.record drake|mujoco_pinocchio URDF FOLDER

A file for each experiment: comments with what was measured of the whole run, then a row every 20 ms.
"""

import argparse
import importlib.metadata
import pathlib

from .closed_loop.experiments import EXPERIMENTS, Trace, run
from .closed_loop.robot import Robot

EVERY = 20
COLUMNS = "t_s,base_x_m,base_y_m,base_yaw_rad,flange_x_m,flange_y_m,flange_z_m,taxel_n"
PACKAGES = {"drake": ["drake", "pin"], "mujoco_pinocchio": ["mujoco", "pin"]}


def written(trace: Trace, packages: list[str]) -> str:
    versions = ", ".join(f"{package} {importlib.metadata.version(package)}" for package in packages)
    head = [f"# {versions}", f"# peak_n={trace.peak_n:.10g}", f"# flange_rms_mm={trace.flange_rms_mm:.10g}", COLUMNS]
    rows = [",".join(f"{value:.10g}" for value in row) for row in trace.rows[::EVERY]]
    return "\n".join([*head, *rows]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("engine", choices=PACKAGES)
    parser.add_argument("urdf", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    robot = Robot.read(arguments.urdf)
    if arguments.engine == "drake":
        from .drake.plant import DrakePlant as build
    else:
        from .mujoco_pinocchio.plant import MujocoPlant as build
    for experiment in EXPERIMENTS:
        trace = run(experiment, robot, build)
        path = arguments.folder / f"{arguments.engine}-{experiment.name}.csv"
        path.write_text(written(trace, PACKAGES[arguments.engine]))
        print(f"{path}: peak {trace.peak_n:.9g} N, flange {trace.flange_rms_mm:.7g} mm RMS")


if __name__ == "__main__":
    main()
