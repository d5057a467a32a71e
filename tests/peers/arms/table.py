"""Public arms through `mocad`: what other people's URDF files bring.

Takes collections of robot descriptions from PyPI, finds every arm with 6 or 7 turning joints in them, gives each
to `mocad --check` and for some seconds to a lock-step run, and compares kinematics and mass matrix with Pinocchio's.
Prints a table; `--csv FILE` keeps a row for every arm, `--json FILE` with all that is known of it. See README.md for the words of the table.
"""

import argparse
import csv
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import files
import model

IMPEDANCE_S = 3.0
DURATION_S = 4.7
TOLERANCE = 1e-12
REMEDY = re.compile(r"; (set|correct|give|name|write|take|leave|add|rename|make) |has to name|lower stiffnesses|nearest stable|allowed")
BODIES = re.compile(r"set arm\.(mass_kg|inertia_com)|and arm\.inertia_com")
UNSAID = re.compile(r"set ((?:arm\.\w+ = \[[^\]]*\](?: and )?)+)")
# What stands in for numbers that a file does not say: a user would take them from a data sheet.
RANGE_RAD = 2.0 * np.pi
SPEED_RAD_S = 2.0
ENDS = {0: "ran", 2: "refused", 6: "fault"}


def stand_in(key: str, arm: model.Arm) -> list[float]:
    joints = len(arm.joints)
    return {
        "arm.q_min_rad": [-RANGE_RAD] * joints,
        "arm.q_max_rad": [RANGE_RAD] * joints,
        "arm.dq_max_rad_s": [SPEED_RAD_S] * joints,
        "arm.torque_max_nm": arm.torques(),
    }[key]


def remedied(message: str, arm: model.Arm, lists: dict[str, list[float]], row: dict) -> dict[str, list[float]]:
    """Lists that the message asks for, with stand-ins where it has question marks; `row` notes where bodies are from."""
    found = UNSAID.search(message)
    if found:
        more = {}
        for key, values in re.findall(r"(arm\.\w+) = \[([^\]]*)\]", found.group(1)):
            written = [value.strip() for value in values.split(",")]
            more[key] = [other if value == "?" else float(value) for value, other in zip(written, stand_in(key, arm))]
        return more
    if BODIES.search(message) and "outside" not in message and arm.peer is not None and "arm.mass_kg" not in lists:
        row["bodies"], more = arm.peer.bodies()
        return more
    return {}


def configuration(arm: model.Arm, lists: dict[str, list[float]], folder: str) -> str:
    given = "".join(f"{key.removeprefix('arm.')} = {values}\n" for key, values in lists.items())
    return (
        f'[robot]\narm = "own"\n[arm]\nurdf = "{arm.path}"\nbase_link = "{arm.base}"\ntip_link = "{arm.tip}"\n{given}'
        f'[simulation.hand]\ntaxels = []\n[telemetry]\nlisten = ""\n[flight_recorder]\nfolder = "{folder}"\n'
    )


def call(command: list[str], text: str | None = None) -> subprocess.CompletedProcess:
    return subprocess.run(command, capture_output=True, text=True, timeout=600, input=text)


def impedance_s(path: pathlib.Path, rate_hz: float = 1000.0) -> float:
    with path.open() as rows:
        mode = next(rows).rstrip("\n").split(",").index("mode")
        return sum(row.split(",")[mode] == "impedance" for row in rows) / rate_hz


def tried(arm: model.Arm, programs: tuple[str, str]) -> dict:
    mocad, arm_model = programs
    row = {"file": arm.short, "base": arm.base, "tip": arm.tip, "joints": len(arm.joints), "given": []}
    lists: dict[str, list[float]] = {}
    lists["arm.home_rad"] = arm.home(lists)
    with tempfile.TemporaryDirectory() as folder:
        config = pathlib.Path(folder) / "arm.toml"
        while True:
            config.write_text(configuration(arm, lists, folder))
            checked = call([mocad, "--check", "--config", str(config)])
            if checked.returncode == 0:
                break
            message = checked.stderr.strip().split("\n", 1)[-1]
            more = remedied(message, arm, lists, row)
            if not more or set(more) <= set(lists):
                sentence = REMEDY.search(message) is not None and "\n" not in message
                message = re.sub(r"/\S*/", "", message)
                return row | {"end": "refused" if checked.returncode == 2 else "crashed", "message": message, "sentence": sentence}
            if "arm.mass_kg" in more and lists.pop("arm.torque_max_nm", None):
                # torques follow from the bodies, and are asked for again
                row["given"].remove("arm.torque_max_nm")
            row["given"] += sorted(more)
            lists |= more
            lists["arm.home_rad"] = arm.home(lists)
        commands = pathlib.Path(folder) / "commands.csv"
        command = [mocad, "--config", str(config), "--as-fast-as-possible", "--duration", str(DURATION_S)]
        ran = call([*command, "--log-level", "error", "--command-log", str(commands)])
        row["end"] = ENDS.get(ran.returncode, "crashed")
        if ran.returncode != 0:
            return row | {"message": "accepted, then: " + ran.stderr.strip().replace("\n", " ")[-300:]}
        row["impedance_s"] = impedance_s(commands)
        postures = arm.postures(lists)
        theirs = arm.reference(postures)
        if theirs is None:
            return row | {"message": "Pinocchio does not read the file"}
        ours = call([arm_model, str(config)], "\n".join(" ".join(map(repr, q)) for q in postures.tolist()))
        ours = [json.loads(line) for line in ours.stdout.splitlines()]
        row["difference"] = max(model.difference(a, b) for a, b in zip(ours, theirs, strict=True))
    return row


def runs_right(row: dict) -> bool:
    ran = row["end"] == "ran" and row.get("impedance_s", 0.0) >= IMPEDANCE_S
    return ran and row.get("difference", 1.0) <= TOLERANCE


def kind(row: dict) -> str:
    """Keys that the script gave, in the table's words."""
    if not row["given"]:
        return "as it is"
    return f"bodies {row['bodies']}" if "bodies" in row else "limits given"


def table(rows: list[dict]) -> str:
    names = list(dict.fromkeys(row["file"].split("/")[0] for row in rows))
    kinds = ["as it is", "limits given", "bodies mended", "bodies made up"]
    lines = [f"| collection | arms | right | {' | '.join(kinds)} | refused | without a remedy | accepted, then failed |"]
    lines.append("|---" * 10 + "|")
    for name in [*names, "all"]:
        some = [row for row in rows if name in (row["file"].split("/")[0], "all")]
        right = [row for row in some if runs_right(row)]
        refused = [row for row in some if row["end"] == "refused"]
        mute = [row for row in refused if not row["sentence"]]
        each = " | ".join(str(sum(kind(row) == one for row in right)) for one in kinds)
        failed = len(some) - len(right) - len(refused)
        lines.append(f"| {name} | {len(some)} | {len(right)} | {each} | {len(refused)} | {len(mute)} | {failed} |")
    return "\n".join(lines)


def write_csv(path: pathlib.Path, rows: list[dict]) -> None:
    with path.open("w", newline="") as file:
        file.write("# tests/peers/arms/run --csv docs/data/arms.csv\n")
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["file", "base_link", "tip_link", "joints", "outcome", "given beside arm.home_rad", "bodies", "off Pinocchio", "said"])
        for row in rows:
            outcome = "right" if runs_right(row) else row["end"]
            off = f"{row['difference']:.1e}" if "difference" in row else ""
            given = " ".join(key.removeprefix("arm.") for key in row["given"])
            out.writerow([row["file"], row["base"], row["tip"], row["joints"], outcome, given, row.get("bodies", ""), off, row.get("message", "")])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocad", default="target/debug/mocad")
    parser.add_argument("--arm-model", default="target/debug/examples/arm_model")
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path("target/peers-arms"))
    parser.add_argument("--only", default="", help="part of a file's path")
    parser.add_argument("--csv", type=pathlib.Path)
    parser.add_argument("--json", type=pathlib.Path)
    arguments = parser.parse_args()
    arms = [arm for path in files.urdfs(arguments.folder) for arm in model.arms(path, arguments.folder)]
    arms = [arm for arm in arms if arguments.only in arm.short]
    programs = (os.path.abspath(arguments.mocad), os.path.abspath(arguments.arm_model))

    def try_one(arm: model.Arm) -> dict:
        try:
            return tried(arm, programs)
        except Exception as error:
            return {"file": arm.short, "base": arm.base, "tip": arm.tip, "end": "script", "given": [], "message": repr(error)}

    with ThreadPoolExecutor(max_workers=2) as pool:
        rows = []
        for row in pool.map(try_one, arms):
            rows.append(row)
            if not runs_right(row):
                print(json.dumps(row, ensure_ascii=False), flush=True)
    if arguments.csv:
        write_csv(arguments.csv, rows)
    if arguments.json:
        arguments.json.write_text("\n".join(json.dumps(row, ensure_ascii=False) for row in rows) + "\n")
    print(table(rows))
    failed = [row for row in rows if not runs_right(row) and row["end"] != "refused"]
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
