"""How many steps of 20 ticks a CPU second makes, by the ways to have many robots: python batch.py [SECONDS]

    python batch.py --threads               two threads against one, taken in turn, on a machine that is idle otherwise

Each line is also given as a ratio. CPU is that of this process and its children, so the numbers bear a busy machine; a
second thread shows in the time of the wall, and only where a second core is idle. `BATCH_ALONE`, the path of
`python/target/release/examples/batch_alone`, adds the instructions of a step next to those of the same robots in Rust alone;
valgrind counts them. `--threads` also runs two batches that share nothing, each with half of the robots: more than they no
sharing can reach on that machine.
"""

import math
import os
import resource
import subprocess
import sys
import threading
import time

import gymnasium
import numpy as np

import moca
import moca.gym

ROBOTS = 8
THREADS = sys.argv[1:2] == ["--threads"]
SECONDS = float(sys.argv[1]) if len(sys.argv) == 2 and not THREADS else 4.0
# Turns of one thread and of two. They are short and many: a virtual machine's cores change their speed from second to second.
TURNS, TURN_S = 60, 0.2


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


def batch(threads, robots=ROBOTS):
    made = moca.SimBatch(moca.gym.LEAN, robots, threads)
    made.reset(range(robots))
    return lambda actions: made.step(actions * [0.2, 0.2, 0.0], 20)


def vector(env):
    env.reset(seed=0)
    return env.step


def rate(step, robots):
    """Steps of all robots in a second of a turn."""
    rng, steps, begun = np.random.default_rng(0), 0, time.perf_counter()
    while time.perf_counter() - begun < TURN_S:
        step(rng.uniform(-1, 1, (robots, 3)))
        steps += robots
    return steps / (time.perf_counter() - begun)


def together(halves, robots):
    """Steps of both halves of the robots in a second, each half on a thread of its own."""
    rates = [0.0, 0.0]

    def run(half):
        rates[half] = rate(halves[half], robots // 2)

    threads = [threading.Thread(target=run, args=(half,)) for half in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(rates)


def compare_threads(robots):
    """Prints the ratios of two threads, and of two batches, to one thread: median and quartiles of all turns."""
    one, two, halves = batch(1, robots), batch(2, robots), [batch(1, robots // 2) for _ in range(2)]
    turns = []
    for _ in range(TURNS):
        alone = rate(one, robots)
        turns.append((rate(two, robots) / alone, together(halves, robots) / alone))
    for name, ratios in zip(("two threads", "two batches"), np.transpose(turns), strict=True):
        low, median, high = np.quantile(ratios, (0.25, 0.5, 0.75))
        print(f"{robots:2d} robots, {name}: {median:.2f} of one thread, half of the turns {low:.2f} to {high:.2f}")


def smooth(steps):
    """Steps of a batch with the targets that `batch_alone` has, in an array made once."""
    made, actions = moca.SimBatch(moca.gym.LEAN, ROBOTS, 1), np.zeros((ROBOTS, 3))
    made.reset(range(ROBOTS))
    for number in range(steps):
        actions[:, 0], actions[:, 1] = 0.2 * math.sin(number), 0.2 * math.cos(number)
        made.step(actions, 20)


def instructions(command):
    """Instructions of a step of one robot: those of 60 steps less those of 20, so that no start is in them."""
    counts = []
    for steps in (20, 60):
        counter = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *command, str(steps)]
        said = subprocess.run(counter, check=True, capture_output=True, text=True).stderr
        counts.append(int(said.split("Collected :")[1].split()[0]))
    return (counts[1] - counts[0]) / (40 * ROBOTS)


def compare_alone(program):
    ours, alone = instructions([sys.executable, __file__, "--smooth"]), instructions([program, str(ROBOTS)])
    print(f"SimBatch: {ours:.0f} instructions a step, {ours / alone:.3f} of Rust alone")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--smooth"]:
        smooth(int(sys.argv[2]))
        sys.exit()
    print("load average", *os.getloadavg())
    if THREADS:
        for number in (ROBOTS, 64):
            compare_threads(number)
        print("load average", *os.getloadavg())
        sys.exit()
    measure("SimBatch, 1 thread", batch(1))
    if program := os.environ.get("BATCH_ALONE"):
        compare_alone(program)
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
