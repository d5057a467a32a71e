import re
import subprocess
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import moca
from conftest import ROOT

pytest.importorskip("pyarrow")


@pytest.fixture(scope="session")
def logs(mocad, tmp_path_factory):
    """A calm run, and one in which a hand presses."""
    folder = tmp_path_factory.mktemp("logs")
    config = folder / "mocad.toml"
    made = []
    for name, hand in [("calm", "simulation.hand.taxels = []\n"), ("pressed", "simulation.hand.force_n = 40.0\n")]:
        config.write_text(f'{hand}telemetry.listen = ""\n')
        made.append(folder / f"{name}.mcap")
        command = [mocad, "--config", config, "--as-fast-as-possible", "--duration", "20", "--record", made[-1]]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return made


def test_table_has_the_columns_of_the_log_with_unix_time(logs):
    log = moca.read(logs[1])
    table = log.to_arrow()
    assert len(table) == len(log) and set(table["robot"].to_pylist()) == {log.name}
    assert set(table["run"].to_pylist()) == {"pressed"}
    times = table["time"].cast("int64").to_numpy()
    assert np.allclose((times - log.start_unix_ns) * 1e-9, log["time_s"], atol=1e-9)
    forces = np.array(table["taxel_force_n"].to_pylist())
    assert np.array_equal(forces, log["taxel_force_n"], equal_nan=True)


def test_export_keeps_whole_files_and_refuses_two_of_one_name(logs, tmp_path):
    with ProcessPoolExecutor(2) as pool:
        made = moca.export(logs, tmp_path, pool=pool)
    (tmp_path / "calm.parquet").write_bytes(b"kept")
    (tmp_path / "pressed.parquet").unlink()
    assert moca.export(logs, tmp_path) == made
    assert (tmp_path / "calm.parquet").read_bytes() == b"kept" and (tmp_path / "pressed.parquet").stat().st_size > 1000
    with pytest.raises(ValueError, match="have the same name"):
        moca.export([logs[0], tmp_path / "calm.mcap"], tmp_path)


def test_queries_of_the_page_answer(logs, tmp_path, monkeypatch):
    duckdb = pytest.importorskip("duckdb")
    monkeypatch.chdir(tmp_path)
    moca.export(logs, "tables")
    page = (ROOT / "docs" / "beyond-one-machine.md").read_text()
    forces, stops, over = [duckdb.sql(query).fetchall() for query in re.findall(r"```sql\n(.*?)```", page, re.S)]
    read = {log.stem: moca.read(log) for log in logs}
    largest = {run: np.nanmax(log["taxel_force_n"], axis=0) for run, log in read.items()}
    assert len(forces) == 22 and all(largest[run][taxel - 1] == newton for _, run, taxel, newton in forces)
    pressed = read["pressed"]
    many = np.count_nonzero(np.nan_to_num(pressed["taxel_force_n"]).max(axis=1) > 25)
    assert many > 50 and over == [(pressed.name, "pressed", many)]
    stopped = pressed["mode"] == "protective stop"
    begins = np.count_nonzero(stopped[1:] & ~stopped[:-1])
    assert [row[2] for row in stops] == ([begins] if begins else [])
