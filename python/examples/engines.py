"""What an engine costs a campaign.

    python engines.py [threads] [processes] [ray] [dask]     all that are installed, by default
    python engines.py --wall [RUNS]                          RUNS of the 10 000 collisions on one core and on two, alone on the machine

For each engine, two workers:

    overhead      CPU of driver, daemons and workers for each second of chunks that last 1 s and compute nothing
    a task        the same for chunks that take no time, each with the rows of 1 s
    start         time until the engine answers
    first rows    time from `Sweep.run` to the first row in the file, the engine being up

Then the driver's memory at 10 000 and at 100 000 runs, with a row function that only claims to take the time of a collision,
and from all of it the wall time of 10 000 collisions on 1 to 10 000 cores: a projection, no measurement. Overheads are CPU
time, which bears a busy machine; start and first rows do not.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import moca
from moca import _sweep

WORKERS = 2
PLAN = {
    "set": {"engine": "analytic", "duration": 4.0, "person.gap": 0.05},
    "grid": {"person.taxel": ["T1", "T2", "T3", "T4"], "sensor.period_ms": [5, 10, 20, 33, 50]},
    "random": {"samples": 500, "seed": 1, "uniform": {"speed": [0.05, 0.25]}, "log": {"person.mass": [10, 200]}},
}
ROW = "1234," + ",".join(["0.123456789012345"] * 18)
CHUNKS, TASKS = 16, 200
# Most that an engine may take of the CPU of chunks of 1 s.
OVERHEAD_MAX = 0.03


def idle(seconds, rows):
    time.sleep(seconds)
    return [ROW] * rows


def tree_cpu_s(root):
    """CPU of a process and of all below it, their dead children included, s."""
    parents, own = {}, {}
    for process in filter(str.isdigit, os.listdir("/proc")):
        try:
            fields = Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2].split()
        except OSError:
            continue
        parents[int(process)], own[int(process)] = int(fields[1]), sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    below, todo = set(), [root]
    while todo:
        process = todo.pop()
        below.add(process)
        todo += [child for child, parent in parents.items() if parent == process and child not in below]
    return sum(own.get(process, 0.0) for process in below)


def threads():
    return ThreadPoolExecutor(WORKERS)


def processes():
    return ProcessPoolExecutor(WORKERS)


def ray():
    from moca.pools import RayPool

    os.environ.setdefault("RAY_worker_niceness", "0")
    return RayPool(num_cpus=WORKERS, include_dashboard=False)


def dask():
    from distributed import Client

    return Client(n_workers=WORKERS, threads_per_worker=1, dashboard_address=None).get_executor()


def costs(pool, seconds, tasks, rows):
    """CPU of a task, s."""
    for future in [pool.submit(idle, 0.0, 1) for _ in range(2 * WORKERS)]:
        future.result()
    before = tree_cpu_s(os.getpid())
    for future in [pool.submit(idle, seconds, rows) for _ in range(tasks)]:
        future.result()
    return (tree_cpu_s(os.getpid()) - before) / tasks


def first_rows_s(pool):
    """Time to the first row in the file, s."""
    plan = {**PLAN, "random": {**PLAN["random"], "samples": 2}}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.csv"
        begun, seen = time.perf_counter(), []

        def watch():
            while not seen:
                if out.exists() and out.read_bytes().count(b"\n") > 1:
                    seen.append(time.perf_counter() - begun)
                time.sleep(0.002)

        watcher = threading.Thread(target=watch)
        watcher.start()
        moca.Sweep(plan).run(out, pool)
        watcher.join(5)
        return seen[0]


def memory(samples, run_s):
    """Peak memory of a process that drives a campaign whose rows are made up, MB."""

    def claimed(_spec, begin, end):
        return [str(run) + ROW[4:] for run in range(begin, end)], run_s * (end - begin)

    _sweep._chunk = claimed
    plan = {**PLAN, "random": {**PLAN["random"], "samples": samples}}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(WORKERS) as pool:
        moca.Sweep(plan).run(Path(folder) / "out.csv", pool)
    # `ru_maxrss` would be that of the parent as well.
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def collision_s():
    """CPU of a collision of the plan, s."""
    plan = moca.Sweep(PLAN)
    numbers = range(0, len(plan), len(plan) // 100)
    before = time.thread_time()
    for run in numbers:
        plan.rows(run, run + 1)
    return (time.thread_time() - before) / len(numbers)


def wall(runs):
    """Prints the time of collisions on one core and on two, in this process."""
    samples = max(1, runs // 20)
    plan = {**PLAN, "random": {**PLAN["random"], "samples": samples}}
    made, whole = 20 * samples, len(moca.Sweep(PLAN))
    cores = sorted(os.sched_getaffinity(0))
    for number in range(1, min(2, len(cores)) + 1):
        os.sched_setaffinity(0, cores[:number])
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(number) as pool:
            begun, used = time.perf_counter(), time.process_time()
            moca.Sweep(plan).run(Path(folder) / "out.csv", pool)
            took, used = time.perf_counter() - begun, time.process_time() - used
        more = "" if made == whole else f"; {whole} by their number: {took * whole / made:.0f} s, {used * whole / made:.0f} s of CPU"
        print(f"{number} cores: {made} collisions in {took:.1f} s, {used:.1f} s of CPU{more}", flush=True)


def project(run_s, engine, start_s, task_s):
    """Prints the wall time of 10 000 collisions: start, then whatever takes longest, the workers or the driver.

    The start is that of two workers: that of thousands depends on their cluster.
    """
    runs = len(moca.Sweep(PLAN))
    line = []
    # Processes are of one machine.
    for cores in (1, 2) if engine == "processes" else (1, 2, 100, 10_000):
        chunk = max(1, min(round(1.0 / run_s), runs // cores))
        chunks = runs / chunk
        work_s, driver_s = runs * run_s / cores, chunks * task_s
        limit = "start" if start_s > max(work_s, driver_s) else "workers" if work_s > driver_s else "driver"
        line.append(f"{cores} cores {start_s + max(work_s, driver_s):.1f} s ({limit})")
    print(f"{engine:10s} {', '.join(line)}")


def main():
    if sys.argv[1:2] == ["--memory"]:
        print(memory(int(sys.argv[2]), float(sys.argv[3])))
        return
    if sys.argv[1:2] == ["--wall"]:
        print("load average", *os.getloadavg())
        wall(int(sys.argv[2]) if len(sys.argv) > 2 else 10_000)
        print("load average", *os.getloadavg())
        return
    wanted = sys.argv[1:] or ["threads", "processes", "ray", "dask"]
    print("load average", *os.getloadavg())
    run_s = collision_s()
    print(f"a collision takes {1e3 * run_s:.1f} ms of CPU, {1 / run_s:.0f} make 1 s")
    rows, found, dear = max(1, round(1.0 / run_s)), {}, []
    for name in wanted:
        begun = time.perf_counter()
        try:
            pool = globals()[name]()
        except ImportError:
            print(f"{name:10s} is not installed")
            continue
        with pool:
            pool.submit(idle, 0.0, 1).result()
            start_s = time.perf_counter() - begun
            first_s = first_rows_s(pool)
            overhead, task_s = costs(pool, 1.0, CHUNKS, rows), costs(pool, 0.0, TASKS, rows)
        found[name] = start_s, task_s
        if overhead > OVERHEAD_MAX:
            dear.append(name)
        print(f"{name:10s} overhead {100 * overhead:.2f} % at chunks of 1 s, {1e3 * task_s:.2f} ms a task, start {start_s:.1f} s, "
              f"first rows {first_s:.2f} s", flush=True)
    peaks = []
    for samples in (500, 5000):
        said = subprocess.run([sys.executable, __file__, "--memory", str(samples), str(run_s)], check=True, capture_output=True, text=True)
        peaks.append(float(said.stdout))
    print(f"memory of the driver, rows made up: {peaks[0]:.1f} MB at 10 000 runs, {peaks[1]:.1f} MB at 100 000")
    print("10 000 collisions, projected; disk: 2 MB")
    for name, (start_s, task_s) in found.items():
        if name != "threads":
            project(run_s, name, start_s, task_s)
    print("load average", *os.getloadavg())
    if dear:
        sys.exit(f"more than {100 * OVERHEAD_MAX:.0f} % of the CPU: {', '.join(dear)}")


if __name__ == "__main__":
    main()
