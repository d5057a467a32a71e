"""Logs as a LeRobot data set, version 3.0: https://huggingface.co/docs/lerobot/lerobot-dataset-v3.

Each log becomes a part, a table of its frames, on any worker. The parts are then joined into a folder that appears only when
it is whole.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# A longer time without a row ends an episode, s: a log shows one each 20 ms.
GAP_S = 0.1
FPS_MAX = 50
CHUNK_FILES = 1000
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
NUMBERED = ("frame_index", "episode_index", "index", "task_index")
BASE_BODY = ["base_vx_body_m_s", "base_vy_body_m_s", "base_yaw_rate_rad_s"]
FLANGE = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]


def _joined_signs(quaternions: Array) -> Array:
    """The same orientations, each with the sign next to the one before; the first has its largest element positive.

    A jump between the two signs of an orientation would be learned as a motion.
    """
    first = quaternions[0, np.argmax(np.abs(quaternions[0]))]
    turns = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0
    signs = np.cumprod(np.concatenate([[-1.0 if first < 0 else 1.0], np.where(turns, -1.0, 1.0)]))
    return np.asarray(quaternions * signs[:, np.newaxis])


def _features(log: Any) -> dict[str, tuple[list[str], Array]]:
    """Name of each feature of a row → names of its elements, and its numbers; not known is NaN."""
    yaw, (vx, vy, rate) = log["base_pose_world"][:, 2], log["base_velocity_world"].T
    cos, sin = np.cos(yaw), np.sin(yaw)
    state, action = [np.stack([cos * vx + sin * vy, cos * vy - sin * vx, rate], 1)], [log["base_velocity_command_body"]]
    state_names, action_names = BASE_BODY.copy(), BASE_BODY.copy()
    joints = log["q_rad"].shape[1]
    if joints:
        state += [log["flange_position_world"], _joined_signs(log["flange_quaternion_world"])]
        action += [log["flange_desired_position_world"], _joined_signs(log["flange_desired_quaternion_world"])]
        state_names += [f"flange_{name}" for name in FLANGE]
        action_names += [f"flange_desired_{name}" for name in FLANGE]
    features = {
        "observation.state": (state_names, np.hstack(state)),
        "observation.base": (["base_x_m", "base_y_m", "base_yaw_rad"], log["base_pose_world"]),
    }
    if joints:
        names = [name.format(i + 1) for name in ("q{}_rad", "dq{}_rad_s") for i in range(joints)]
        features["observation.joints"] = names, np.hstack([log["q_rad"], log["dq_rad_s"]])
        features["observation.torque"] = [f"torque{i + 1}_nm" for i in range(joints)], log["arm_torque_nm"]
    return features | {"action": (action_names, np.hstack(action))}


def _frames(log: Any, fps: int) -> tuple[dict[str, tuple[list[str], Array]], list[int]]:
    """Features of the frames, and the number of frames of each episode.

    An episode is a stretch without a gap in which a law is in control and the state is known. A robot that waits or brakes
    does not do the task.
    """
    features, times_s = _features(log), log["time_s"]
    known = [np.isfinite(numbers).all(axis=1) for _, numbers in features.values()]
    learned = np.asarray(log._inner.moves()) & np.all(known, axis=0)
    ends = np.flatnonzero(~(learned[1:] & learned[:-1] & (np.diff(times_s) <= GAP_S))) + 1
    rows, ages_s, lengths = [], [], []
    for first, end in zip([0, *ends], [*ends, len(log)]):
        if first < end and learned[first]:
            own_s = times_s[first:end]
            # A microsecond is less than the loop's period and more than rounding.
            frames_s = own_s[0] + np.arange(int((own_s[-1] - own_s[0] + 1e-6) * fps) + 1) / fps
            at = np.searchsorted(own_s, frames_s + 1e-6, side="right") - 1
            rows.append(first + at)
            ages_s.append(np.maximum(frames_s - own_s[at], 0.0))
            lengths.append(len(at))
    if not rows:
        raise ValueError(f"{log._path}: no law was in control")
    chosen, age_s = np.concatenate(rows), np.concatenate(ages_s)
    found = {name: (names, numbers[chosen].astype(np.float32)) for name, (names, numbers) in features.items()}
    force = log["taxel_force_n"][chosen]
    if force.shape[1]:
        taxels, then_s = [f"t{i + 1}" for i in range(force.shape[1])], log["frame_age_s"][chosen]
        # One NaN would spoil all that is learned: a force that means nothing is 0, and `valid` says so.
        found["observation.tactile.force"] = taxels, np.nan_to_num(force).astype(np.float32)
        found["observation.tactile.valid"] = taxels, np.isfinite(force)
        age = np.where(np.isfinite(then_s), then_s + age_s, -1.0)
        found["observation.tactile.age"] = [], age.astype(np.float32)[:, np.newaxis]
    number = np.concatenate([np.arange(length) for length in lengths])
    found["timestamp"] = [], (number / fps).astype(np.float32)[:, np.newaxis]
    episode = np.repeat(np.arange(len(lengths)), lengths)
    for name, values in zip(NUMBERED, (number, episode, np.arange(len(number)), np.zeros(len(number), int))):
        found[name] = [], values[:, np.newaxis]
    return found, lengths


def _arrow() -> tuple[Any, Any]:
    return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")


def _column(values: Array) -> Any:
    """Lists of one length; a list of one is a number there."""
    arrow, _ = _arrow()
    rows, width = values.shape
    flat = arrow.array(np.ascontiguousarray(values).ravel())
    return flat if width == 1 else arrow.ListArray.from_arrays(np.arange(rows + 1, dtype=np.int32) * width, flat)


def _values(column: Any, width: int) -> Array:
    whole = column.combine_chunks()
    flat = whole if width == 1 else whole.flatten()
    return np.asarray(flat.to_numpy(zero_copy_only=False).reshape(-1, width))


def part(log: str, out: str, fps: int) -> None:
    """What a worker does: the frames of one log as a table that says what it holds. It may be made twice."""
    arrow, parquet = _arrow()
    moca: Any = importlib.import_module("moca")
    read = moca.read(log)
    read._inner.load()
    features, lengths = _frames(read, fps)
    about = {"robot": read._inner.arm, "lengths": lengths, "names": {name: names for name, (names, _) in features.items()}}
    table = arrow.table({name: _column(values) for name, (_, values) in features.items()})
    fresh = f"{out}.{os.getpid()}.part"
    parquet.write_table(table.replace_schema_metadata({"moca": json.dumps(about)}), fresh)
    os.replace(fresh, out)


def _statistics(values: Array) -> dict[str, list[Any]]:
    numbers = values.astype(np.float64)
    found = {name: getattr(np, name)(numbers, axis=0).tolist() for name in ("min", "max", "mean", "std")}
    levels = np.quantile(numbers, list(QUANTILES.values()), axis=0).tolist()
    return found | dict(zip(QUANTILES, levels)) | {"count": [len(numbers)]}


def _join(parts: dict[str, str], out: Path, fps: int, task: str) -> None:
    """Writes the data set of parts (log → its table) into a folder."""
    arrow, parquet = _arrow()
    first: dict[str, Any] = {}
    episodes: list[dict[str, Any]] = []
    frames = 0
    for file, (log, place) in enumerate(parts.items()):
        table = parquet.read_table(place)
        about = json.loads(table.schema.metadata[b"moca"])
        first = first or {"log": log, **about}
        if about["names"] != first["names"]:
            raise ValueError(f"{log} and {first['log']} have not the same joints and taxels: export them apart")
        numbers = {"episode_index": len(episodes), "index": frames}
        for name, before in numbers.items():
            at = table.column_names.index(name)
            table = table.set_column(at, name, arrow.compute.add(table[name], before))
        place_in_set = {"chunk_index": file // CHUNK_FILES, "file_index": file % CHUNK_FILES}
        path = out / DATA.format(**place_in_set)
        path.parent.mkdir(parents=True, exist_ok=True)
        at = 0
        with parquet.ParquetWriter(path, table.schema.remove_metadata()) as writer:
            for length in about["lengths"]:
                rows = table.slice(at, length)
                writer.write_table(rows)
                at += length
                row = {"episode_index": len(episodes), "tasks": [task], "length": length}
                row |= {f"data/{name}": value for name, value in place_in_set.items()}
                row |= {"dataset_from_index": frames, "dataset_to_index": frames + length}
                row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
                for name, names in about["names"].items():
                    found = _statistics(_values(rows[name], max(1, len(names))))
                    row |= {f"stats/{name}/{statistic}": values for statistic, values in found.items()}
                episodes.append(row)
                frames += length
    _describe(out, first, episodes, frames, fps, task)


def _describe(out: Path, about: dict[str, Any], episodes: list[dict[str, Any]], frames: int, fps: int, task: str) -> None:
    """Writes `meta/`."""
    arrow, parquet = _arrow()
    (out / EPISODES).parent.mkdir(parents=True)
    parquet.write_table(arrow.Table.from_pylist(episodes), out / EPISODES)
    features: dict[str, Any] = {}
    statistics: dict[str, Any] = {}
    files = sorted((out / "data").glob("*/*.parquet"))
    for name, names in about["names"].items():
        # One feature of all files at a time is in memory.
        columns = [parquet.read_table(file, columns=[name])[name] for file in files]
        values = np.concatenate([_values(column, max(1, len(names))) for column in columns])
        features[name] = {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": names or None}
        statistics[name] = _statistics(values)
    info = {
        "codebase_version": "v3.0",
        "robot_type": about["robot"],
        "total_episodes": len(episodes),
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": DATA,
        "video_path": None,
        "features": features,
    }
    for file, value in (("info", info), ("stats", statistics)):
        (out / "meta" / f"{file}.json").write_text(json.dumps(value, indent=2), encoding="utf-8")
    # The words of each task, which pandas takes as the table's index.
    kinds = (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    described = [{"name": name, "field_name": name, "pandas_type": kind, "numpy_type": own, "metadata": None} for name, kind, own in kinds]
    pandas: dict[str, Any] = {"index_columns": ["task"], "column_indexes": [], "columns": described}
    pandas |= {"creator": {"library": "moca", "version": "0"}, "pandas_version": "2.0.0"}
    tasks = arrow.table({"task_index": arrow.array([0], arrow.int64()), "task": [task]})
    parquet.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(pandas)}), out / "meta" / "tasks.parquet")


def export(logs: list[str], out: Path, pool: Executor | None, fps: int, task: str) -> None:
    """Makes the parts that `out.parts` lacks, then the data set, then removes the parts."""
    if not 1 <= fps <= FPS_MAX:
        raise ValueError(f"fps = {fps}: allowed: 1 to {FPS_MAX}, the rows that a log has in a second")
    if not logs:
        raise ValueError("no logs")
    if out.exists():
        return
    folder = Path(f"{out}.parts")
    folder.mkdir(parents=True, exist_ok=True)
    places = {log: str(folder / f"{Path(log).stem}.{fps}.parquet") for log in logs}
    todo = [(log, place) for log, place in places.items() if not os.path.exists(place)]
    if pool is None:
        for log, place in todo:
            part(log, place, fps)
    else:
        for future in [pool.submit(part, log, place, fps) for log, place in todo]:
            future.result()
    fresh = Path(f"{out}.{os.getpid()}.part")
    try:
        _join(places, fresh, fps, task)
        os.rename(fresh, out)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    shutil.rmtree(folder)
