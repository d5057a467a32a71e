"""Times of this crate beside quadprog, DAQP and eiquadprog on the same problems, in one run.

python3 -m venv V; V/bin/pip install numpy quadprog daqp eiquadprog cmeel-eigen; V/bin/python crates/qp/compare/compare.py
Each problem five times, the best counts. quadprog is called through Python (about a microsecond of it is the call);
DAQP reports its own setup and solve time; eiquadprog is compiled (g++ -O2) against its library with Eigen.
"""
import pathlib
import subprocess
import sys
import tempfile
import time

import daqp
import numpy as np
import quadprog

HERE = pathlib.Path(__file__).parent
NAMES = ["contact 4x36", "random 4x36", "random 10x30"]


def show(name, solver, seconds, error, refused):
    us = np.sort(np.array(seconds)) * 1e6
    print(f"{name:<14} {solver:<20} median {us[len(us) // 2]:7.2f}  99 % {us[len(us) * 99 // 100]:7.2f}  "
          f"worst {us[-1]:7.2f} us; furthest from moca-qp {error:.1e}; "
          f"{refused} refused")


def best_of_five(call):
    times = []
    for _ in range(5):
        began = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - began)
    return min(times), result


def solve_all(name, problems):
    for solver in ["quadprog (Python)", "DAQP"]:
        seconds, worst, refused = [], 0.0, 0
        for h, f, rows, x in problems:
            a, lower, upper = np.ascontiguousarray(rows[:, :-2]), rows[:, -2].copy(), rows[:, -1].copy()
            if solver == "DAQP":
                sense = np.zeros(len(a), dtype=np.int32)
                results = [daqp.solve(h, f, a, upper, lower, sense) for _ in range(5)]
                seconds.append(min(r[3]["setup_time"] + r[3]["solve_time"] for r in results))
                found = results[0][0]
            else:
                normals = np.vstack([a[lower > -1e29], -a[upper < 1e29]]).T.copy()
                bounds = np.concatenate([lower[lower > -1e29], -upper[upper < 1e29]])
                try:
                    took, result = best_of_five(lambda: quadprog.solve_qp(h, -f, normals, bounds))
                except ValueError:  # "constraints are inconsistent", where every row goes through one point
                    refused += 1
                    continue
                seconds.append(took)
                found = result[0]
            worst = max(worst, np.abs(found - x).max())
        show(name, solver, seconds, worst, refused)


def eiquadprog(path, scratch):
    prefix = next(p for p in map(pathlib.Path, sys.path) if (p / "cmeel.prefix").exists()) / "cmeel.prefix"
    program = scratch / "compare"
    subprocess.run(["g++", "-O2", "-DNDEBUG", "-std=c++17", HERE / "compare.cpp", "-o", program, f"-I{prefix}/include",
                    f"-I{prefix}/include/eigen3", f"-L{prefix}/lib", "-leiquadprog", f"-Wl,-rpath,{prefix}/lib"],
                   check=True)
    subprocess.run([program, path], check=True)


def main():
    scratch = pathlib.Path(tempfile.mkdtemp())
    path = scratch / "problems"
    subprocess.run(["cargo", "bench", "-q", "-p", "moca-qp", "--bench", "compare", "--", path], check=True)
    data, at = np.fromfile(path), 0
    for name in NAMES:
        count, n, m = (int(v) for v in data[at:at + 3])
        at, problems = at + 3, []
        for _ in range(count):
            sizes = [n * n, n, m * (n + 2), n]
            h, f, rows, x = np.split(data[at:at + sum(sizes)], np.cumsum(sizes)[:-1])
            at += sum(sizes)
            problems.append((h.reshape(n, n).copy(), f.copy(), rows.reshape(m, n + 2), x))
        solve_all(name, problems)
    eiquadprog(path, scratch)


if __name__ == "__main__":
    main()
