"""Runs the command of an indexed Job for every index, as its pods would, and joins what they wrote.

usage: kubernetes_job.py MANIFEST FOLDER

The plan is a small one. One index is torn and run again, as after the loss of its node. Exits non-zero if a pod fails, or if
the joined file is not that of one process. Needs `moca-lab` on the PATH and PyPI `PyYAML`.
"""

import os
import pathlib
import shutil
import subprocess
import sys

import yaml

PLAN = """
set = { engine = "analytic", duration = 0.6, "person.gap" = 0.001 }
grid = { "person.taxel" = ["T1", "T2"] }
random = { samples = 60, seed = 1, uniform = { speed = [0.05, 0.25] } }
"""
RETRIED = 7

job, folder = yaml.safe_load(pathlib.Path(sys.argv[1]).read_text())["spec"], pathlib.Path(sys.argv[2]).absolute()
container = job["template"]["spec"]["containers"][0]
shutil.rmtree(folder, ignore_errors=True)
for mount in container["volumeMounts"]:
    (folder / mount["mountPath"].lstrip("/")).mkdir(parents=True)
plan, data = folder / "plan" / "sweep.toml", folder / container["workingDir"].lstrip("/")
plan.write_text(PLAN)
# Volumes are folders here.
command = [word.replace("/plan/", f"{plan.parent}/") for word in container["command"]]


def pod(index):
    environment = {**os.environ, "JOB_COMPLETION_INDEX": str(index)}
    subprocess.run(command, cwd=data, env=environment, check=True, stdout=subprocess.DEVNULL)


def lab(out, *more):
    run = ["moca-lab", "--quiet", "sweep", plan, "--out", out, *more]
    subprocess.run(run, check=True, stdout=subprocess.DEVNULL)
    return out.read_bytes()


for index in range(job["completions"]):
    pod(index)
torn = data / "parts" / f"{RETRIED}.csv"
torn.write_bytes(torn.read_bytes()[:-9])
pod(RETRIED)
parts = sorted((data / "parts").iterdir())
assert len(parts) == job["completions"], f"{len(parts)} files of {job['completions']} indexes"
whole = lab(folder / "alone.csv")
assert lab(folder / "joined.csv", "--merge", *parts) == whole, "the joined file is not that of one process"
print(f"{job['completions']} indexes, one of them twice: {whole.count(10) - 1} rows, equal to those of one process")
