"""A policy that leads the flange to a place while people push, from training to the running robot.

    pip install moca[gym] stable-baselines3 onnx onnxruntime matplotlib
    python learn_push.py train DIR [STEPS]       PPO on 32 robots of moca.SimBatch: policy.onnx, curve.csv, result.json
    python learn_push.py run DIR [SECONDS]       the policy leads the robot of a running `mocad` at 50 Hz: run.csv
    python learn_push.py draw DIR PICTURE        learning curve and run

Each episode draws a robot of its own (`RANDOM`), by the keys of a sweep. `run` takes the robot as it is, with its protections;
`MOCAD_ADDRESS` names another daemon than this user's own.
"""

import csv
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

import moca
from moca.gym import PushEnv, PushVectorEnv

ROBOTS = 32
STEPS = 250_000
SEED = 1
# Steps of a trial of the finished policy, almost an episode of 10 s, and those of its end that count.
TRIAL, END = 450, 100
PERIOD_S = 0.02
# A step at full speed is worth 1.
GAIN = 1 / (0.1 * PERIOD_S)
RANDOM = {
    "uniform": {"true.base.order_delay_ms": (0, 60), "true.foam.scale": (0.7, 1.3), "true.base.odometry_scale": (0.97, 1.03)},
    "log": {"m_v": (2, 8), "d_v": (40, 160)},
}


def scales(width):
    """Magnitudes of what is seen: way left, pose and velocity of the base, then forces."""
    return np.array([0.1] * 3 + [0.5] * 3 + [0.2] * 3 + [15.0] * (width - 9), np.float32)


def scaled(seen):
    return np.asarray(seen, np.float32) / scales(np.shape(seen)[-1])


def robots_for_sb3(env):
    """A vector environment of Gymnasium as one of stable-baselines3.

    The reward is the way that each step comes nearer: what an action does shows within a few steps, and a robot that came all
    the way has the most. `distance_m` of the infos has the environment's own reward, negative.
    """
    from stable_baselines3.common.vec_env import VecEnv

    class Robots(VecEnv):
        def __init__(self):
            super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

        def reset(self):
            seen, _ = env.reset(seed=SEED)
            self._before = np.linalg.norm(seen[:, :3], axis=1)
            return scaled(seen)

        def step_async(self, actions):
            self._actions = actions

        def step_wait(self):
            seen, reward, terminated, truncated, more = env.step(self._actions)
            ended = terminated | truncated
            nearer = (self._before + reward) * GAIN
            self._before = np.where(ended, np.linalg.norm(seen[:, :3], axis=1), -reward)
            infos = [{"distance_m": -one} for one in reward]
            for i in np.flatnonzero(ended):
                last = scaled(more["final_obs"][i])
                infos[i] |= {"terminal_observation": last, "TimeLimit.truncated": bool(truncated[i] & ~terminated[i])}
            return scaled(seen), nearer.astype(np.float32), ended, infos

        def close(self):
            pass

        def get_attr(self, name, indices=None):
            return [getattr(env, name, None)] * self.num_envs

        def set_attr(self, name, value, indices=None):
            raise NotImplementedError

        def env_method(self, name, *arguments, indices=None, **keywords):
            raise NotImplementedError

        def env_is_wrapped(self, wrapper, indices=None):
            return [False] * self.num_envs

    return Robots()


def train(folder, steps):
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    folder.mkdir(parents=True, exist_ok=True)
    env = robots_for_sb3(PushVectorEnv(ROBOTS, random=RANDOM))
    curve = []

    class Curve(BaseCallback):
        """Distance from the place at the end of each episode, m."""

        def _on_step(self):
            ends = [info["distance_m"] for info in self.locals["infos"] if "terminal_observation" in info]
            if ends:
                curve.append((self.num_timesteps, np.mean(ends)))
            return True

    policy = {"net_arch": [64, 64], "log_std_init": -1.0}
    settings = {"n_steps": 64, "batch_size": 256, "n_epochs": 10, "gamma": 0.95, "learning_rate": lambda left: 1e-3 * left}
    model = PPO("MlpPolicy", env, policy_kwargs=policy, seed=SEED, device="cpu", **settings)
    torch.set_num_threads(1)
    begun = time.perf_counter()
    model.learn(steps, callback=Curve())
    took = time.perf_counter() - begun
    with open(folder / "curve.csv", "w", newline="") as file:
        csv.writer(file).writerows([("steps", "distance_m"), *curve])
    export(model, folder / "policy.onnx")
    result = {"steps": model.num_timesteps, "robots": ROBOTS, "seconds": round(took, 1), "steps_per_s": round(model.num_timesteps / took)}
    result["distance_mm"] = compared(folder / "policy.onnx")
    (folder / "result.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))


def export(model, path):
    """The mean action of a policy as ONNX, the scales of what it sees inside."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    # Layer after layer: torch's own exporter needs one more package and gives the same graph.
    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    width = model.observation_space.shape[0]
    constants = {"scale": scales(width)}
    nodes = [helper.make_node("Div", ["observation", "scale"], ["x"])]
    last = "x"
    for i, layer in enumerate(layers):
        out = f"x{i}"
        if hasattr(layer, "weight"):
            constants |= {f"w{i}": layer.weight.detach().numpy(), f"b{i}": layer.bias.detach().numpy()}
            nodes.append(helper.make_node("Gemm", [last, f"w{i}", f"b{i}"], [out], transB=1))
        else:
            nodes.append(helper.make_node(type(layer).__name__, [last], [out]))
        last = out
    constants |= {"lowest": np.array(-1.0), "highest": np.array(1.0)}
    nodes.append(helper.make_node("Clip", [last, "lowest", "highest"], ["action"]))
    tensors = [numpy_helper.from_array(np.asarray(value, np.float32), name) for name, value in constants.items()]
    seen, done = (helper.make_tensor_value_info(*end) for end in (
        ("observation", TensorProto.FLOAT, ["n", width]),
        ("action", TensorProto.FLOAT, ["n", 3]),
    ))
    graph = helper.make_graph(nodes, "push", [seen], [done], tensors)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(made)
    onnx.save(made, path)
    # What runs on the robot is what was trained.
    import torch

    sample = np.random.default_rng(0).normal(0, scales(width), (100, width))
    with torch.no_grad():
        wanted = model.policy.get_distribution(torch.as_tensor(scaled(sample))).mode().clip(-1, 1).numpy()
    assert np.abs(loaded(path)(sample) - wanted).max() < 1e-4, "the exported policy is another one"


def loaded(path):
    """Actions of an exported policy."""
    import onnxruntime

    session = onnxruntime.InferenceSession(os.fspath(path), providers=["CPUExecutionProvider"])
    return lambda seen: session.run(None, {"observation": np.asarray(seen, np.float32)})[0]


def compared(path):
    """Distance from the place 7 to 9 s after the start, mm, of robots that training has not seen."""
    ways = {
        "no command": lambda seen: np.zeros((len(seen), 3)),
        "straight at it, gain 10/s": lambda seen: -100.0 * seen[:, :3],
        "policy": loaded(path),
    }
    found = {}
    for name, act in ways.items():
        env = PushVectorEnv(ROBOTS // 2, random=RANDOM)
        seen, _ = env.reset(seed=10_000)
        distances, stops = [], 0
        for step in range(TRIAL):
            seen, reward, terminated, *_ = env.step(act(seen))
            stops += int(terminated.sum())
            if step >= TRIAL - END:
                distances.append(-reward)
        mean, largest = (round(1e3 * float(of(distances)), 1) for of in (np.mean, np.max))
        found[name] = {"mean": mean, "largest": largest, "stops": stops}
    return found


def run(folder, seconds):
    """Leads the robot of a running daemon and writes what happened."""
    act, rows, late, refused = loaded(folder / "policy.onnx"), [], [], 0
    with moca.connect(os.environ.get("MOCAD_ADDRESS")) as robot:
        until = time.monotonic() + 60
        while robot.state.mode != "impedance":
            if time.monotonic() > until:
                sys.exit(f"the robot is {robot.state.mode}: it has to be armed, in impedance")
            time.sleep(0.1)
        begun = time.monotonic()
        for step in range(round(seconds / PERIOD_S)):
            due = begun + step * PERIOD_S
            time.sleep(max(0.0, due - time.monotonic()))
            late.append(time.monotonic() - due)
            state = robot.state
            seen = PushEnv.observe(state)
            if state.mode == "impedance":
                try:
                    robot.target_twist(PushEnv.command(act(seen[np.newaxis])[0]))
                except moca.Refused:
                    # Somebody touches, and a touch wins.
                    refused += 1
            force = np.nan_to_num(state.taxel_force_n).max(initial=0.0)
            rows.append((state.time_s, np.linalg.norm(seen[:3]), force, state.mode, state.fault or ""))
    with open(folder / "run.csv", "w", newline="") as file:
        csv.writer(file).writerows([("time_s", "distance_m", "force_n", "mode", "fault"), *rows])
    distance = 1e3 * np.array([row[1] for row in rows])
    touched = np.array([row[2] for row in rows]) > 5.0
    half = len(rows) // 2
    said = {
        "seconds": seconds,
        "targets": len(rows),
        "refused": refused,
        "lateness_ms_p99": round(1e3 * float(np.quantile(late, 0.99)), 1),
        "distance_mm": {"at first": round(distance[0], 1), "mean of the second half": round(distance[half:].mean(), 1)},
        "touched": round(float(touched.mean()), 3),
        "largest_force_n": round(max(row[2] for row in rows), 1),
        "stops": sorted({row[4] for row in rows if row[4]}),
    }
    (folder / "run.json").write_text(json.dumps(said, indent=1) + "\n")
    print(json.dumps(said, indent=1))


def draw(folder, picture):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    curve = np.genfromtxt(folder / "curve.csv", delimiter=",", names=True)
    live = np.genfromtxt(folder / "run.csv", delimiter=",", names=True, usecols=(0, 1, 2))
    result = json.loads((folder / "result.json").read_text())["distance_mm"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.plot(1e-3 * curve["steps"], 1e3 * curve["distance_m"], color="#1f5fa8", label="robots that learn, at the end of each episode")
    for (name, value), style in zip(result.items(), (":", "--", "-.")):
        label = f"{name}, 7 to 9 s after the start: {value['mean']:.0f} mm"
        left.axhline(value["mean"], color="#555555", linestyle=style, linewidth=1, label=label)
    left.set(xlabel="thousand steps of 20 ms, all robots", ylabel="distance of the flange from its place, mm", title="Learning")
    left.set_ylim(0, None)
    left.legend(frameon=False, fontsize=8)
    time_s = live["time_s"] - live["time_s"][0]
    right.plot(time_s, 1e3 * live["distance_m"], color="#1f5fa8", label="distance, mm")
    right.set(xlabel="time, s", ylabel="distance, mm", ylim=(0, None), title="The policy on the running daemon, 50 Hz")
    force = right.twinx()
    force.fill_between(time_s, live["force_n"], color="#d98032", alpha=0.4, linewidth=0, label="largest force on a taxel, N")
    force.set(ylabel="force, N", ylim=(0, max(40.0, 1.5 * live["force_n"].max())))
    shown = [sum(pair, []) for pair in zip(*(axis.get_legend_handles_labels() for axis in (right, force)))]
    right.legend(*shown, frameon=False, fontsize=8)
    figure.savefig(picture, dpi=90)


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in ("train", "run", "draw"):
        sys.exit(__doc__)
    folder = Path(sys.argv[2])
    if sys.argv[1] == "train":
        train(folder, int(sys.argv[3]) if len(sys.argv) > 3 else STEPS)
    elif sys.argv[1] == "run":
        run(folder, float(sys.argv[3]) if len(sys.argv) > 3 else 60.0)
    else:
        draw(folder, sys.argv[3])
