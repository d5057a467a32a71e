"""Logs as tables: Arrow in memory, files for many logs."""

from __future__ import annotations

import importlib
import os
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterable

import numpy as np

from moca import _lerobot

if TYPE_CHECKING:
    from moca import Log


def table(log: Log, run: str) -> Any:
    """A row for each instant of the log, its fields under the names of `State`: numbers, or lists of one length."""
    arrow: Any = importlib.import_module("pyarrow")
    rows = len(log)
    since_start_ns = np.round(log["time_s"] * 1e9).astype(np.int64)
    columns: dict[str, Any] = {
        "robot": arrow.repeat(log.name, rows).dictionary_encode(),
        "run": arrow.repeat(run, rows).dictionary_encode(),
        "time": arrow.array(log.start_unix_ns + since_start_ns, arrow.timestamp("ns", "UTC")),
    }
    for name in log.keys():
        values = log[name]
        if values.dtype.kind == "U":
            columns[name] = arrow.array([word or None for word in values.tolist()], arrow.string()).dictionary_encode()
        elif values.ndim == 1:
            columns[name] = arrow.array(values)
        elif values.shape[1]:
            flat = arrow.array(np.ascontiguousarray(values).ravel())
            columns[name] = arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return arrow.table(columns)


def _flat(rows: Any) -> Any:
    """The table with a column for each element of a list: `q_rad` becomes `q_rad_1` and so on."""
    arrow: Any = importlib.import_module("pyarrow")
    columns: dict[str, Any] = {}
    for name in rows.column_names:
        column = rows[name].combine_chunks()
        if arrow.types.is_fixed_size_list(column.type):
            values = column.flatten().to_numpy().reshape(len(column), -1)
            columns |= {f"{name}_{i + 1}": arrow.array(values[:, i], from_pandas=True) for i in range(values.shape[1])}
        elif arrow.types.is_floating(column.type):
            columns[name] = arrow.array(column.to_numpy(), from_pandas=True)
        else:
            columns[name] = column
    return arrow.table(columns)


def _file(log: str, out: str) -> None:
    """What a worker does: the file appears only when it is whole, so it may be made twice."""
    moca: Any = importlib.import_module("moca")
    fresh = f"{out}.{os.getpid()}.part"
    rows = moca.read(log).to_arrow()
    if out.endswith(".csv"):
        csv: Any = importlib.import_module("pyarrow.csv")
        csv.write_csv(_flat(rows), fresh)
    else:
        parquet: Any = importlib.import_module("pyarrow.parquet")
        parquet.write_table(rows, fresh)
    os.replace(fresh, out)


def export(
    logs: Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    format: str = "parquet",
    pool: Executor | None = None,
    fps: int = 50,
    task: str = "give way to touch",
) -> list[str]:
    """Writes logs in a form that other programs read, on the workers of `pool`. Needs `pyarrow`.

    "parquet" and "csv" make a file for each log in the folder `out`, and the paths are returned. Each row has the
    robot's name, the run, which is the log's name without its ending, and Unix time. What is not known is NaN in
    Parquet and an empty field in CSV.

    "lerobot" makes the folder `out` a LeRobot data set, version 3.0, with `fps` frames a second and the words of `task`.

    What is there is kept and appears only when it is whole, so a call that was interrupted is repeated.
    """
    if format not in ("parquet", "csv", "lerobot"):
        raise ValueError(f"format = {format!r}: allowed: 'parquet', 'csv', 'lerobot'")
    folder = Path(out)
    places: dict[str, str] = {}
    for given in logs:
        log = os.fspath(given)
        place = str(folder / f"{Path(log).stem}.{format}")
        if place in places:
            raise ValueError(f"{places[place]} and {log} have the same name, which names the run: rename one")
        places[place] = log
    if format == "lerobot":
        _lerobot.export(list(places.values()), folder, pool, fps, task)
        return [str(folder)]
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(log, place) for place, log in places.items() if not os.path.exists(place)]
    if pool is None:
        for log, place in todo:
            _file(log, place)
    else:
        for future in [pool.submit(_file, log, place) for log, place in todo]:
            future.result()
    return list(places)
