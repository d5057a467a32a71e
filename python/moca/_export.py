"""Logs as tables: Arrow in memory, Parquet files for many logs."""

from __future__ import annotations

import importlib
import os
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterable

import numpy as np

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
        if name == "mode":
            columns[name] = arrow.array(values.tolist(), arrow.string()).dictionary_encode()
        elif values.ndim == 1:
            columns[name] = arrow.array(values)
        elif values.shape[1]:
            flat = arrow.array(np.ascontiguousarray(values).ravel())
            columns[name] = arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
    return arrow.table(columns)


def _file(log: str, out: str) -> None:
    """What a worker does: the file appears only when it is whole, so it may be made twice."""
    moca: Any = importlib.import_module("moca")
    parquet: Any = importlib.import_module("pyarrow.parquet")
    fresh = f"{out}.{os.getpid()}.part"
    parquet.write_table(table(moca.read(log), Path(log).stem), fresh)
    os.replace(fresh, out)


def export(
    logs: Iterable[str | os.PathLike[str]], out: str | os.PathLike[str], *, pool: Executor | None = None
) -> list[str]:
    """Writes a Parquet file for each log into the folder `out`, on the workers of `pool`, and returns their paths.

    Each row has the robot's name, the run, which is the log's name without its ending, and Unix time. A file that is
    there is kept, so a call that was interrupted is repeated. Needs `pyarrow`.
    """
    folder = Path(out)
    places: dict[str, str] = {}
    for given in logs:
        log = os.fspath(given)
        place = str(folder / f"{Path(log).stem}.parquet")
        if place in places:
            raise ValueError(f"{places[place]} and {log} have the same name, which names the run: rename one")
        places[place] = log
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(log, place) for place, log in places.items() if not os.path.exists(place)]
    if pool is None:
        for log, place in todo:
            _file(log, place)
    else:
        for future in [pool.submit(_file, log, place) for log, place in todo]:
            future.result()
    return list(places)
