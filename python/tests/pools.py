"""Sweeps on engines that lose a part while they work: the file is the one of this process, byte for byte.

Not of `python -m pytest python/tests`: `.ci/pools` installs the engines and names this file.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import moca

PLAN = {
    "set": {"engine": "analytic", "duration": 4.0, "person.gap": 0.05},
    "grid": {"person.taxel": ["T1", "T2"], "sensor.period_ms": [5, 20]},
    "random": {"samples": 30, "seed": 1, "uniform": {"speed": [0.05, 0.25]}},
}
# Rows in the file when a part is killed: before the first row, soon after it, and in the middle.
MOMENTS = [0, 5, 40]


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "out.csv"
    moca.Sweep(PLAN).run(out)
    return out.read_bytes()


class Killer(threading.Thread):
    """Kills a process once the file has so many rows."""

    def __init__(self, out, rows, process):
        super().__init__(daemon=True)
        self.out, self.rows, self.process, self.killed_at = Path(out), rows, process, None

    def run(self):
        while not self.out.exists() or self.out.read_bytes().count(b"\n") < self.rows:
            time.sleep(0.01)
        os.kill(self.process, signal.SIGKILL)
        self.killed_at = self.out.read_bytes().count(b"\n")


def swept(out, pool, rows, process):
    killer = Killer(out, rows, process)
    killer.start()
    begun = time.monotonic()
    moca.Sweep(PLAN).run(out, pool)
    killer.join(60)
    print(f"killed with {killer.killed_at} lines of {len(moca.Sweep(PLAN)) + 1}, whole after {time.monotonic() - begun:.1f} s")
    assert killer.killed_at is not None and killer.killed_at <= len(moca.Sweep(PLAN)), "nothing was left to do"
    return out.read_bytes()


@pytest.mark.parametrize("rows", MOMENTS)
def test_ray_with_a_killed_node_misses_no_row(whole, tmp_path, monkeypatch, rows):
    pytest.importorskip("ray")
    # Ray's workers give way to everybody else: on a busy machine they would not get on.
    monkeypatch.setenv("RAY_worker_niceness", "0")
    from ray.cluster_utils import Cluster

    from moca.pools import RayPool

    small = {"object_store_memory": 80 << 20}
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False, **small})
    try:
        nodes = [cluster.add_node(num_cpus=1, **small) for _ in range(2)]
        cluster.wait_for_nodes()
        with RayPool(cluster.address) as pool:
            # Two workers that run: one of them is lost.
            for future in [pool.submit(time.sleep, 1.0) for _ in range(2)]:
                future.result(120)
            raylet = nodes[1].all_processes["raylet"][0].process.pid
            assert swept(tmp_path / "out.csv", pool, rows, raylet) == whole
    finally:
        cluster.shutdown()


@pytest.mark.parametrize("rows", MOMENTS)
def test_dask_with_a_killed_worker_misses_no_row(whole, tmp_path, rows):
    distributed = pytest.importorskip("distributed")
    program = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    place = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes = [subprocess.Popen([*program, "--no-dashboard", "--scheduler-file", place], **quiet)]
    try:
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", place, "--no-dashboard"]
        worker += ["--nthreads", "1", "--no-nanny", "--memory-limit", "0", "--local-directory", tmp_path]
        while not place.exists():
            assert processes[0].poll() is None
            time.sleep(0.05)
        processes += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        with distributed.Client(scheduler_file=str(place)) as client:
            client.wait_for_workers(2, timeout=60)
            assert swept(tmp_path / "out.csv", client.get_executor(), rows, processes[2].pid) == whole
    finally:
        for process in processes:
            process.kill()
            process.wait()
