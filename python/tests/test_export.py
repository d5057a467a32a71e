import collections
import csv
import itertools
import re
import subprocess
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import moca
from conftest import ROOT

pytest.importorskip("pyarrow")


# What strikes each log, if anything; the cause that it has then.
FAULTS = {None: None, "unplugged": "board-lost", "taxel-dead": "taxel-invalid", "joint-nan": "state-invalid", "silent": "board-silent"}
LOGS = 20
WEEK_US = 7 * 24 * 3600 * 1_000_000


@pytest.fixture(scope="session")
def logs(mocad, tmp_path_factory):
    """A calm run and others in which hands press, by both laws, some with a fault."""
    folder = tmp_path_factory.mktemp("logs")
    made = []
    for i, (fault, law) in zip(range(LOGS), itertools.cycle(itertools.product(FAULTS, ["impedance", "follow-me"]))):
        hand = "taxels = []" if i == 0 else f"force_n = {20 + 2 * i}.0\nevery_s = 2.0\nhold_s = 0.8"
        config = folder / f"{i}.toml"
        config.write_text(f'startup.law = "{law}"\ntelemetry.listen = ""\n[simulation.hand]\n{hand}\n')
        made.append(folder / f"{i:02}-{law}-{fault}.mcap")
        inject = ["--inject", f"{fault}@9.1"] if fault else []
        command = [mocad, "--config", config, "--as-fast-as-possible", "--duration", "12", "--record", made[-1], *inject]
        ended = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
        # 6: stopped at its end.
        assert ended == (6 if fault else 0), made[-1]
    return made


def test_table_has_the_columns_of_the_log_with_unix_time(logs):
    log = moca.read(logs[1])
    table = log.to_arrow()
    assert len(table) == len(log) and set(table["robot"].to_pylist()) == {log.name}
    assert set(table["run"].to_pylist()) == {logs[1].stem}
    times = table["time"].cast("int64").to_numpy()
    assert np.allclose((times - log.start_unix_ns) * 1e-9, log["time_s"], atol=1e-9)
    forces = np.array(table["taxel_force_n"].to_pylist())
    assert np.array_equal(forces, log["taxel_force_n"], equal_nan=True)
    assert set(table["fault_code"].to_pylist()) == {None} and "follow-me" in table["law"].to_pylist()


def test_export_keeps_whole_files_and_refuses_two_of_one_name(logs, tmp_path):
    with ProcessPoolExecutor(2) as pool:
        made = moca.export(logs[:2], tmp_path, pool=pool)
    kept, again = map(Path, made)
    kept.write_bytes(b"kept")
    again.unlink()
    assert moca.export(logs[:2], tmp_path) == made
    assert kept.read_bytes() == b"kept" and again.stat().st_size > 1000
    with pytest.raises(ValueError, match="have the same name"):
        moca.export([logs[0], tmp_path / logs[0].name], tmp_path)


def test_csv_has_the_numbers_of_the_table(logs, tmp_path):
    (made,) = moca.export(logs[2:3], tmp_path, format="csv")
    log = moca.read(logs[2])
    with open(made, newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(log) and rows[0]["robot"] == log.name and rows[0]["run"] == logs[2].stem
    for name in log.keys():
        values = log[name]
        for i in range(values.shape[1] if values.ndim > 1 else 0):
            said = [float(row[f"{name}_{i + 1}"] or "nan") for row in rows]
            assert np.array_equal(said, values[:, i], equal_nan=True), name
        if values.ndim == 1:
            said = [row[name] if values.dtype.kind == "U" else float(row[name] or "nan") for row in rows]
            assert np.array_equal(said, values, equal_nan=values.dtype.kind != "U"), name
    assert "" in {row["taxel_force_n_1"] for row in rows}, "not known is an empty field"


def answers_of_numpy(read):
    """The three answers of the page, computed row by row. Logs from the middle on are a week younger."""
    largest, stops, contacts = [], collections.Counter(), []
    for i, (run, log) in enumerate(sorted(read.items())):
        forces, stopped = log["taxel_force_n"], np.isin(log["mode"], ["protective stop", "fault"])
        largest += [(log.name, run, t + 1, np.nanmax(forces[:, t])) for t in range(11) if not np.isnan(forces[:, t]).all()]
        time_us = (log.start_unix_ns + np.round(log["time_s"] * 1e9).astype(np.int64)) // 1000 + WEEK_US * (i >= LOGS // 2)
        # Unix time began on a Thursday, weeks begin on Mondays.
        weeks = (time_us + 3 * WEEK_US // 7) // WEEK_US * WEEK_US - 3 * WEEK_US // 7
        begins = np.flatnonzero(stopped & ~np.concatenate([[False], stopped[:-1]]))
        stops.update((log.name, weeks[at], log["fault_code"][at]) for at in begins)
        strongest = np.nan_to_num(forces, nan=-1.0).max(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], strongest > 25, [False]]).astype(int)))
        for first, end in zip(edges[::2], edges[1::2]):
            contacts.append((log.name, run, log["law"][first], time_us[first], strongest[first:end].max()))
    return largest, sorted((*key, count) for key, count in stops.items()), contacts


def microseconds(rows, column):
    return [(*row[:column], round(row[column].timestamp() * 1e6), *row[column + 1 :]) for row in rows]


@pytest.fixture(scope="session")
def tables(logs, tmp_path_factory):
    """Tables of all logs, and their answers."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    folder = tmp_path_factory.mktemp("tables")
    for made in sorted(moca.export(logs, folder / "tables"))[LOGS // 2 :]:
        table = parquet.read_table(made)
        later = arrow.compute.add(table["time"], arrow.scalar(1000 * WEEK_US, arrow.duration("ns")))
        parquet.write_table(table.set_column(2, "time", later), made)
    answers = answers_of_numpy({log.stem: moca.read(log) for log in logs})
    largest, stops, contacts = answers
    assert len(largest) > 11 * LOGS - 3 and {cause for _, _, cause, _ in stops} == set(FAULTS.values()) - {None}
    assert len({week for _, week, *_ in stops}) == 2 and {law for _, _, law, *_ in contacts} == {"impedance", "follow-me"}
    return folder, answers


def test_queries_of_the_page_in_duckdb_answer_right(tables, monkeypatch):
    duckdb = pytest.importorskip("duckdb")
    folder, (largest, stops, contacts) = tables
    monkeypatch.chdir(folder)
    duckdb.sql("SET TimeZone = 'UTC'")
    page = (ROOT / "docs" / "beyond-one-machine.md").read_text()
    said = [duckdb.sql(query).fetchall() for query in re.findall(r"```sql\n(.*?)```", page, re.S)]
    assert said[0] == largest
    assert microseconds(said[1], 1) == stops
    assert microseconds(said[2], 3) == contacts


def test_queries_of_the_page_in_polars_answer_right(tables, monkeypatch):
    pytest.importorskip("polars")
    folder, (largest, stops, contacts) = tables
    monkeypatch.chdir(folder)
    page = (ROOT / "docs" / "beyond-one-machine.md").read_text()
    said = {}
    exec("\n".join(code for code in re.findall(r"```python\n(.*?)```", page, re.S) if "pl." in code), said)
    assert said["largest"].rows() == largest
    assert microseconds(said["stops"].rows(), 1) == stops
    assert microseconds(said["contacts"].rows(), 3) == contacts


def test_numbers_that_are_none_are_as_the_page_says():
    duckdb, polars = pytest.importorskip("duckdb"), pytest.importorskip("polars")
    nan = float("nan")
    numbers = polars.Series("x", [1.0, nan, 2.0])
    assert numbers.max() == 2.0 and (numbers > 25).to_list() == [False, True, False]
    (row,) = duckdb.sql("SELECT isnan(max(x)), 'nan'::DOUBLE > 25 FROM (VALUES (1.0::DOUBLE), ('nan'::DOUBLE)) AS t(x)").fetchall()
    assert row == (True, True)
