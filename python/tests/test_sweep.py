import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import pytest

import moca
from conftest import ROOT

PLAN = {
    "set": {"engine": "analytic", "duration": 0.3, "person.gap": 0.001},
    "grid": {"person.taxel": ["T1", "T3"], "d_v": [40, 80]},
    "random": {"samples": 10, "seed": 5, "uniform": {"speed": [0.05, 0.25]}, "log": {"m_v": [1, 20]}},
}
TEXT = """
set = { engine = "analytic", duration = 0.3, "person.gap" = 0.001 }
grid = { "person.taxel" = ["T1", "T3"], d_v = [40, 80] }
random = { samples = 10, seed = 5, uniform = { speed = [0.05, 0.25] }, log = { m_v = [1, 20] } }
"""
RUN = "import moca, sys; moca.Sweep(sys.argv[1]).run(sys.argv[2])"


# Drawn meetings are ten times as long as a collision of the plan.
MEETINGS = 8


def written(out, *words):
    """Bytes of the file that a command of `moca-lab` writes."""
    program = os.environ.get("MOCA_LAB", ROOT / "target/debug/moca-lab")
    subprocess.run([program, "--quiet", *words, "--out", out], check=True, stdout=subprocess.DEVNULL)
    return out.read_bytes()


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """Rows of `moca-lab sweep`."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "plan.toml").write_text(TEXT)
    return written(folder / "out.csv", "sweep", folder / "plan.toml")


@pytest.fixture(scope="session")
def drawn(tmp_path_factory):
    """Rows of `moca-lab protection`."""
    out = tmp_path_factory.mktemp("drawn") / "out.csv"
    return written(out, "protection", "--random", str(MEETINGS), "--seed", "3")


@pytest.mark.parametrize("threads", [1, 2, 7])
def test_threads_give_the_bytes_of_the_command(lab, tmp_path, threads):
    with ThreadPoolExecutor(threads) as pool:
        moca.Sweep(PLAN).run(tmp_path / "out.csv", pool)
    assert (tmp_path / "out.csv").read_bytes() == lab


def test_processes_give_the_bytes_of_the_command(lab, tmp_path):
    with ProcessPoolExecutor(2) as pool:
        moca.Sweep(TEXT).run(tmp_path / "out.csv", pool=pool)
    assert (tmp_path / "out.csv").read_bytes() == lab


@pytest.mark.parametrize("executor", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_drawn_meetings_give_the_bytes_of_the_command(drawn, tmp_path, executor):
    out = tmp_path / "out.csv"
    # A file of fewer runs is continued, its torn row made again.
    out.write_bytes(drawn[: drawn.rindex(b"\n2,") + 20])
    with executor(2) as pool:
        moca.Protection(MEETINGS, seed=3).run(out, pool)
    assert out.read_bytes() == drawn


def test_drawn_meetings_travel_and_say_their_columns(drawn):
    meetings = pickle.loads(pickle.dumps(moca.Protection(MEETINGS, seed=3)))
    lines = drawn.decode().splitlines()
    assert len(meetings) == MEETINGS and meetings.columns == lines[0].split(",")
    assert meetings.rows(5, 6) == lines[6:7]
    with pytest.raises(ValueError, match="belongs to another campaign"):
        meetings.run(Path(__file__))
    for wrong, message in ((0, 3), "runs 0: allowed: 1 to"), ((1, -1), "seed -1: allowed: 0 to"):
        with pytest.raises(ValueError, match=message):
            moca.Protection(*wrong)


def test_file_of_another_seed_is_refused_and_kept(drawn, tmp_path):
    out = tmp_path / "out.csv"
    out.write_bytes(drawn)
    with pytest.raises(ValueError, match=f"row {MEETINGS - 1} is of another seed, plan or version"):
        moca.Protection(MEETINGS + 1, seed=4).run(out)
    assert out.read_bytes() == drawn


@pytest.mark.parametrize("rows", [1, 15, 33])
def test_killed_driver_goes_on_where_its_file_ends(lab, tmp_path, rows):
    out = tmp_path / "out.csv"
    driver = subprocess.Popen([sys.executable, "-c", RUN, TEXT, out])
    until = time.monotonic() + 120
    while not out.exists() or out.read_bytes().count(b"\n") < 1 + rows:
        assert driver.poll() is None or out.read_bytes() == lab
        assert time.monotonic() < until
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    # As a disk that was full leaves it.
    with open(out, "ab") as file:
        file.write(b"1234,0.0")
    moca.Sweep(TEXT).run(out)
    assert out.read_bytes() == lab


def test_driver_keeps_no_rows():
    def peak_mb(samples):
        command = [sys.executable, ROOT / "python" / "examples" / "engines.py", "--memory", str(samples), "0.01"]
        return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    # Rows are made up, by a function that claims 10 ms for each: 10 000 runs and 100 000.
    assert 0.9 < peak_mb(5000) / peak_mb(500) < 1.1


def test_rows_are_those_of_the_file_and_plans_travel(lab):
    sweep = pickle.loads(pickle.dumps(moca.Sweep(PLAN)))
    lines = lab.decode().splitlines()
    assert len(sweep) == 40 and sweep.columns == lines[0].split(",")
    assert sweep.rows(7, 9) == lines[8:10]
    with pytest.raises(ValueError, match="rows 39 to 41: allowed: 0 to 40"):
        sweep.rows(39, 41)


def test_parquet_has_the_rows_of_the_csv(lab, tmp_path):
    csv = pytest.importorskip("pyarrow.csv")
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "out.parquet"
    moca.Sweep(PLAN).run(out)
    (tmp_path / "out.csv").write_bytes(lab)
    types = parquet.read_schema(out)
    assert parquet.read_table(out) == csv.read_csv(
        tmp_path / "out.csv", convert_options=csv.ConvertOptions(column_types=types)
    )
    assert types.field("person.taxel").type == "string" and types.field("peak_force_n").type == "double"
    assert sorted(os.listdir(tmp_path)) == ["out.csv", "out.parquet"]


def test_progress_says_how_long_it_takes(tmp_path, capsys):
    moca.Sweep(PLAN).run(tmp_path / "out.csv", progress=True)
    assert "40/40 runs, 0 s left" in capsys.readouterr().err


def test_file_of_another_sweep_is_not_touched(tmp_path):
    (tmp_path / "out.csv").write_text("run,d_v\n0,1\n")
    with pytest.raises(ValueError, match="belongs to another campaign"):
        moca.Sweep(PLAN).run(tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text() == "run,d_v\n0,1\n"


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: moca.Sweep({"grid": {"mass": [1]}}), "unknown key mass"),
        (lambda: moca.Sweep("[grid]\nd_v = [-1]\n"), "outside 0"),
        (lambda: moca.experiment("b3"), 'no experiment is called "b3"; allowed: collision'),
        (lambda: moca.experiment("collision", {"speed": 99}), "speed=99.*outside"),
    ],
)
def test_wrong_plan_is_refused_before_anything_runs(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def test_experiment_is_the_report_of_the_command():
    report = moca.experiment("collision", {"sensor": "ideal", "engine": "analytic", "duration": 3.0, "person.gap": 0.05})
    assert report["experiment"] == "collision" and len(report["peak_by_phase_n"]) == 5
    assert report["peak_force_n"] == max(report["peak_by_phase_n"]) > 0
