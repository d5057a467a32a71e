"""Campaigns of collisions over any `concurrent.futures` executor; each row follows from its campaign and its number alone."""

from __future__ import annotations

import functools
import importlib
import json
import os
import sys
import time
from collections import deque
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, Mapping

from moca._moca import Plan
from moca._moca import experiment as _experiment

# Time that a chunk should take, s: the overhead of every engine is below a hundredth of it.
CHUNK_S = 1.0
# Runs of the first chunk, whose time gives the size of the others.
FIRST_RUNS = 5


@functools.lru_cache(maxsize=4)
def _plan(kind: str, *arguments: Any) -> Plan:
    plan: Plan = getattr(Plan, kind)(*arguments)
    return plan


def _chunk(spec: tuple[Any, ...], begin: int, end: int) -> tuple[list[str], float]:
    """What a worker does: rows and the time they took, s. It writes nothing, so it may run twice."""
    begun = time.perf_counter()
    rows = _plan(*spec).rows(begin, end)
    return rows, time.perf_counter() - begun


def _workers(pool: Executor) -> int:
    # An executor of Dask knows its workers by its client.
    client: Any = getattr(pool, "_client", None)
    if client is not None:
        return max(1, int(sum(client.ncores().values())))
    return int(getattr(pool, "_max_workers", 0) or os.cpu_count() or 1)


class Sweep:
    """A plan of collisions: the path of a file such as `scenes/sweep.toml`, its text, or a dict with the same keys.

    A wrong key, value or range raises `ValueError` before anything runs.
    """

    def __init__(self, spec: str | os.PathLike[str] | Mapping[str, Any]) -> None:
        if isinstance(spec, Mapping):
            self.__setstate__(("json", json.dumps(spec)))
        elif isinstance(spec, str) and ("\n" in spec or "=" in spec):
            self.__setstate__(("toml", spec))
        else:
            with open(spec, encoding="utf-8") as file:
                self.__setstate__(("toml", file.read()))

    def __getstate__(self) -> tuple[Any, ...]:
        return self._spec

    def __setstate__(self, spec: tuple[Any, ...]) -> None:
        # A constructor of `Plan` with its arguments: all that a worker needs.
        self._spec = spec
        self._plan = _plan(*spec)

    def __len__(self) -> int:
        return len(self._plan)

    @property
    def columns(self) -> list[str]:
        """Names of the columns: the run, the varied keys, the results."""
        return self._plan.header().split(",")

    def rows(self, begin: int, end: int) -> list[str]:
        """Makes runs `begin` to `end - 1` in this thread and returns their CSV lines; other threads run meanwhile."""
        return self._plan.rows(begin, end)

    def run(self, out: str | os.PathLike[str], pool: Executor | None = None, *, progress: bool | None = None) -> None:
        """Makes every run that `out` lacks, on the workers of `pool`; without one on every core.

        The file is CSV, or Parquet where its name ends so (needs `pyarrow`). Only this process writes it, each row
        once and in order. A call that was interrupted is repeated: it goes on after the last whole row. With
        `progress`, by default on a terminal, it prints the runs made and the time left.
        """
        path = os.fspath(out)
        if path.endswith(".parquet"):
            if os.path.exists(path):
                return
            # The rows of an unfinished sweep; Parquet files cannot be continued.
            part = path + ".csv"
            self.run(part, pool, progress=progress)
            self._to_parquet(part, path)
            os.remove(part)
            return
        if pool is None:
            with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
                return self.run(path, threads, progress=progress)
        shown = sys.stderr.isatty() if progress is None else progress
        done = self._plan.open(path)
        with open(path, "a", encoding="utf-8", newline="") as file:
            self._run(file, done, pool, shown)

    def _run(self, file: Any, done: int, pool: Executor, shown: bool) -> None:
        todo, first, begun = done, done, time.perf_counter()
        size, most = FIRST_RUNS, 2 * _workers(pool)
        under_way: deque[Future[tuple[list[str], float]]] = deque()
        timed = False
        try:
            while done < len(self):
                # Until the first chunk is timed, every worker has a small one.
                while todo < len(self) and len(under_way) < (most if timed else most // 2):
                    end = min(todo + size, len(self))
                    under_way.append(pool.submit(_chunk, self._spec, todo, end))
                    todo = end
                rows, seconds = under_way.popleft().result()
                file.write("".join(row + "\n" for row in rows))
                file.flush()
                done += len(rows)
                if not timed:
                    timed, size = True, max(1, round(CHUNK_S * len(rows) / max(seconds, 1e-6)))
                if shown:
                    left = (time.perf_counter() - begun) / (done - first) * (len(self) - done)
                    print(f"\r{done}/{len(self)} runs, {left:.0f} s left ", end="", file=sys.stderr, flush=True)
        finally:
            for future in under_way:
                future.cancel()
            if shown:
                print(file=sys.stderr)

    def _to_parquet(self, part: str, path: str) -> None:
        try:
            arrow, csv, parquet = (importlib.import_module(f"pyarrow{module}") for module in ("", ".csv", ".parquet"))
        except ImportError as error:
            raise ImportError(f"{path}: Parquet needs pyarrow: pip install pyarrow; the rows are in {part}") from error
        words = self._plan.words()
        types = {name: arrow.string() if name in words else arrow.float64() for name in self.columns} | {"run": arrow.int64()}
        fresh = f"{path}.{os.getpid()}"
        options = csv.ConvertOptions(column_types=types)
        with csv.open_csv(part, convert_options=options) as batches:
            with parquet.ParquetWriter(fresh, batches.schema) as writer:
                for batch in batches:
                    writer.write_batch(batch)
        os.replace(fresh, path)


class Protection(Sweep):
    """Meetings of a robot and a person, drawn at random: the rows of `moca-lab protection --random RUNS --seed SEED`.

    A file of fewer runs with the same seed is continued.
    """

    def __init__(self, runs: int, seed: int = 1) -> None:
        for name, value, least in ("runs", runs, 1), ("seed", seed, 0):
            if not least <= value < 2**63:
                raise ValueError(f"{name} {value}: allowed: {least} to {2**63 - 1}")
        self.__setstate__(("drawn", runs, seed))


def assignments(settings: Mapping[str, Any]) -> list[str]:
    """Settings as `moca-lab experiment --set` takes them."""

    def text(value: Any) -> str:
        if isinstance(value, bool):
            return str(value).lower()
        return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)

    return [f"{key}={text(value)}" for key, value in settings.items()]


def experiment(name: str, settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Runs "collision" with keys of `moca-lab experiment --set` and returns its report, the worst of five sensor phases.

    A wrong key, value or range raises `ValueError`.
    """
    report: dict[str, Any] = json.loads(_experiment(name, assignments(settings or {})))
    return report
