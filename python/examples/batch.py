"""How many steps of 20 ticks a CPU second makes, by the ways to have many robots: python batch.py [SECONDS]

    python batch.py --threads [SECONDS]     two threads against one, taken in turn, on a machine that is idle otherwise

Each line is also given as a ratio. CPU is that of this process and its children, so the numbers bear a busy machine; a
second thread shows in the time of the wall, and only where a second core is idle. `BATCH_ALONE`, the path of
`target/release/examples/batch_alone`, adds the same robots in Rust alone.
"""

import os
import resource
import subprocess
import sys
import time

import gymnasium
import numpy as np

import moca
import moca.gym

ROBOTS = 8
THREADS = sys.argv[1:2] == ["--threads"]
SECONDS = float(sys.argv[1 + THREADS]) if len(sys.argv) > 1 + THREADS else 4.0
# Turns of one thread and of two.
TURNS = 5


def cpu():
    return sum(getattr(resource.getrusage(resource.RUSAGE_SELF), f) for f in ("ru_utime", "ru_stime")) + workers_cpu()


def workers_cpu():
    """CPU time of processes that this one has started, s."""
    total = 0.0
    for process in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{process}/stat") as file:
                fields = file.read().rsplit(") ", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == os.getpid():
            total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def measure(name, step):
    step(np.zeros((ROBOTS, 3)))
    rng, steps = np.random.default_rng(0), 0
    begun, used = time.perf_counter(), cpu()
    while time.perf_counter() - begun < SECONDS:
        step(rng.uniform(-1, 1, (ROBOTS, 3)))
        steps += ROBOTS
    wall, used = time.perf_counter() - begun, cpu() - used
    print(f"{name:24s} {steps / wall:7.0f} steps/s, {1e6 * used / steps:6.1f} us of CPU a step", flush=True)
    return steps / wall, used / steps


def batch(threads):
    robots = moca.SimBatch(moca.gym.LEAN, ROBOTS, threads)
    robots.reset(range(ROBOTS))
    return lambda actions: robots.step(actions * [0.2, 0.2, 0.0], 20)


def vector(env):
    env.reset(seed=0)
    return env.step


def compare_threads():
    """Ratio of two threads to one, the median of some turns: what else runs then slows both."""
    robots = {threads: batch(threads) for threads in (1, 2)}
    ratios = []
    for turn in range(TURNS):
        one, two = (measure(f"turn {turn + 1}, {threads} thread{'s'[: threads - 1]}", robots[threads])[0] for threads in (1, 2))
        ratios.append(two / one)
    print(f"two threads: {np.median(ratios):.2f} of one, {min(ratios):.2f} to {max(ratios):.2f}")


if __name__ == "__main__":
    print("load average", *os.getloadavg())
    if THREADS:
        compare_threads()
        print("load average", *os.getloadavg())
        sys.exit()
    _, alone = measure("SimBatch, 1 thread", batch(1))
    if program := os.environ.get("BATCH_ALONE"):
        steps = str(int(SECONDS / alone / ROBOTS))
        said = subprocess.run([program, str(ROBOTS), steps], check=True, capture_output=True, text=True).stdout
        print(f"{'Rust alone':24s} {said.strip()}; SimBatch takes {1e6 * alone / float(said.split()[0]):.2f} of it")
    one, _ = measure("LeanVectorEnv, 1 thread", vector(moca.gym.LeanVectorEnv(ROBOTS, 1)))
    two, cost = measure("LeanVectorEnv, 2 threads", vector(moca.gym.LeanVectorEnv(ROBOTS, 2)))
    print(f"two threads: {two / one:.2f} of one")
    env = gymnasium.vector.AsyncVectorEnv([moca.gym.LeanEnv] * ROBOTS)
    try:
        _, pipes = measure("AsyncVectorEnv", vector(env))
    finally:
        env.close()
    print(f"LeanVectorEnv: {pipes / cost:.2f} of the steps of AsyncVectorEnv per CPU second")
    print("load average", *os.getloadavg())
