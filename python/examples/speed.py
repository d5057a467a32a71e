"""How fast a log is read, and how much faster than real time a simulated robot steps: python speed.py LOG

A log of ten minutes: mocad --as-fast-as-possible --duration 600 --record run.mcap
"""

import os
import sys
import time

import moca


def timed(run):
    start = time.perf_counter()
    result = run()
    return result, time.perf_counter() - start


print("load average", *os.getloadavg())
for path in sys.argv[1:]:
    log, opening = timed(lambda: moca.read(path))
    columns, reading = timed(lambda: [log[name] for name in log.keys()])
    minutes = log["time_s"][-1] / 60
    print(f"moca.read: {minutes:.1f} min, {len(log)} rows, {len(columns)} columns in {opening + reading:.2f} s")

sim = moca.Sim("simulation.hand.taxels = []\n")
while sim.step(10).mode != "impedance":
    pass
for ticks in (1, 100):
    _, seconds = timed(lambda: [sim.step(ticks) for _ in range(20_000 // ticks)])
    print(f"moca.Sim: {20_000 * sim.period / seconds:.0f} times real time, step({ticks})")
print("load average", *os.getloadavg())
