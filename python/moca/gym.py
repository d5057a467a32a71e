"""Gymnasium environments, one robot or many: `gymnasium.make_vec("moca.gym:moca/Lean-v0", num_envs=64)`.

A vector environment is one `moca.SimBatch`: threads instead of processes, no pickling. Robot i of a vector environment
that was reset with a seed is bit for bit the environment of one robot that was reset with seed + i.

`random` varies the robots: each episode draws its own from ranges as under `[random]` in a sweep's plan, such as
`{"uniform": {"true.foam.scale": [0.7, 1.3]}, "log": {"m_v": [2, 8]}}`.
"""

from __future__ import annotations

from typing import Any, Callable, Mapping, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

import moca

__all__ = ["LeanEnv", "LeanVectorEnv", "PushEnv", "PushVectorEnv"]

Array = NDArray[np.float64]
# Distribution ("uniform" or "log") → key of the configuration → its range.
Ranges = Mapping[str, Mapping[str, tuple[float, float]]]

TICKS = 20
# Chances in each step that a hand begins to press a taxel, and that the one that presses lets go.
PRESS_CHANCE, RELEASE_CHANCE = 0.01, 0.02


class _Task(NamedTuple):
    config: str
    target: str
    # What an action of 1 commands, and components that the action does not reach.
    scale: Array
    zeros: int
    # Force of a press, N.
    force: float
    # Length of an episode, s.
    episode_s: float
    observation: Callable[[Any], Array]
    reward: Callable[[Any], Array]

    def command(self, actions: Any) -> Array:
        """Targets of some actions, a row for each robot."""
        scaled: Array = np.clip(np.atleast_2d(actions), -1, 1) * self.scale
        return np.hstack([scaled, np.zeros((len(scaled), self.zeros))])


def _forces(states: Any) -> Array:
    # A policy cannot learn from NaN. A stale taxel reads 0 here, and only here.
    forces: Array = np.nan_to_num(states.taxel_force_n)
    return forces


def _flange_error(states: Any) -> Array:
    error: Array = states.flange_position_world - _GOAL
    return error


_GOAL = np.array([0.55, 0.0, 0.7])
_CALM = "simulation.hand.taxels = []\n"
# Configuration of the robots of `LeanEnv`.
LEAN = 'startup.law = "follow-me"\n' + _CALM

_LEAN = _Task(
    config=LEAN,
    target="base",
    scale=np.array([0.2, 0.2, 0.5]),
    zeros=0,
    force=10.0,
    episode_s=30.0,
    observation=lambda s: np.hstack([s.base_pose_world, s.base_velocity_world, _forces(s)]),
    reward=lambda s: 1.0 - np.linalg.norm(s.base_pose_world[:, :2], axis=1) - 0.05 * _forces(s).sum(axis=1),
)

_PUSH = _Task(
    config='startup.law = "impedance"\n' + _CALM,
    target="twist world",
    scale=np.array([0.1, 0.1, 0.1]),
    zeros=3,
    force=15.0,
    episode_s=10.0,
    observation=lambda s: np.hstack([_flange_error(s), s.base_pose_world, s.base_velocity_world, _forces(s)]),
    reward=lambda s: -np.linalg.norm(_flange_error(s), axis=1),
)


def _drawn(random: Ranges, rng: np.random.Generator) -> dict[str, float]:
    """Settings of one robot."""
    drawn = {key: rng.uniform(*ends) for key, ends in random.get("uniform", {}).items()}
    return drawn | {key: float(np.exp(rng.uniform(*np.log(ends)))) for key, ends in random.get("log", {}).items()}


class _Lone:
    """A state of one robot, its fields as those of a batch of one."""

    def __init__(self, state: Any) -> None:
        self._state = state

    def __getattr__(self, field: str) -> Any:
        return np.asarray(getattr(self._state, field))[np.newaxis]


class _Robots:
    """Robots of a task; each draws its settings and its hand's presses from a generator of its own."""

    def __init__(self, task: _Task, robots: int, threads: int | None, random: Ranges | None) -> None:
        if unknown := set(random or {}) - {"uniform", "log"}:
            raise ValueError(f"random: {sorted(unknown)}: allowed: uniform, log")
        self.task, self._random = task, random
        self.batch = moca.SimBatch(task.config, robots, threads, target=task.target)
        self._targets = np.zeros((robots, len(task.scale) + task.zeros))
        self._presses = np.zeros((robots, 2))
        # Taxel that is pressed, 1 is T1; 0 for none.
        self._pressed = np.zeros(robots, int)
        self._taxels = self.batch.states.taxel_force_n.shape[1]

    def reset(self, rngs: list[np.random.Generator], where: NDArray[np.bool_] | None = None) -> Array:
        new = [where is None or bool(where[i]) for i in range(len(rngs))]
        self._pressed[new] = 0
        seeds = [int(rng.integers(2**31)) if now else 0 for rng, now in zip(rngs, new)]
        random = self._random
        settings = [_drawn(random, rng) if now else {} for rng, now in zip(rngs, new)] if random else None
        return self.task.observation(self.batch.reset(seeds, where=new, settings=settings))

    def step(self, actions: Any, rngs: list[np.random.Generator]) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
        self._targets[:] = self.task.command(actions)
        self._presses[:] = 0
        for i, rng in enumerate(rngs):
            if self._pressed[i] and rng.random() < RELEASE_CHANCE:
                self._presses[i] = self._pressed[i], 0.0
                self._pressed[i] = 0
            elif not self._pressed[i] and rng.random() < PRESS_CHANCE:
                self._pressed[i] = rng.integers(1, self._taxels + 1)
                self._presses[i] = self._pressed[i], self.task.force
        states = self.batch.step(self._targets, TICKS, self._presses)
        terminated = np.array([fault is not None for fault in states.fault])
        return self.task.observation(states), self.task.reward(states), terminated, states.time_s > self.task.episode_s


def _spaces(task: _Task, robots: _Robots) -> tuple[Any, Any]:
    width = task.observation(robots.batch.states).shape[1]
    action = gymnasium.spaces.Box(-1.0, 1.0, task.scale.shape, np.float64)
    return gymnasium.spaces.Box(-np.inf, np.inf, (width,), np.float64), action


class _OneRobot(gymnasium.Env[Array, Array]):
    """A robot, 20 ticks a step; episodes end with a stop, and after a time of the task."""

    _task: _Task

    def __init__(self, random: Ranges | None = None) -> None:
        self._robots = _Robots(self._task, 1, 1, random)
        self.observation_space, self.action_space = _spaces(self._task, self._robots)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        super().reset(seed=seed)
        return self._robots.reset([self.np_random])[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated = self._robots.step([action], [self.np_random])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), {}

    @classmethod
    def observe(cls, state: moca.State) -> Array:
        """Observation of a running robot, for a policy that was trained here."""
        observation: Array = cls._task.observation(_Lone(state))[0]
        return observation

    @classmethod
    def command(cls, action: Any) -> Array:
        """Target that an action stands for, as `Robot` takes it."""
        target: Array = cls._task.command(action)[0]
        return target


class _ManyRobots(gymnasium.vector.VectorEnv[Array, Array, NDArray[Any]]):
    """Robots that step together. One whose episode ends starts again in the same step; `final_obs` has its last state."""

    _task: _Task
    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}

    def __init__(self, num_envs: int = 1, threads: int | None = None, random: Ranges | None = None) -> None:
        self.num_envs = num_envs
        self._robots = _Robots(self._task, num_envs, threads, random)
        self.single_observation_space, self.single_action_space = _spaces(self._task, self._robots)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed or [None] * self.num_envs
        for i, own in enumerate(seeds):
            if own is not None:
                self._rngs[i] = np.random.default_rng(own)
        return self._robots.reset(self._rngs), {}

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        observation, reward, terminated, truncated = self._robots.step(actions, self._rngs)
        infos: dict[str, Any] = {}
        ended = terminated | truncated
        if ended.any():
            for i in np.flatnonzero(ended):
                infos = self._add_info(infos, {"final_obs": observation[i].copy()}, int(i))
            observation = self._robots.reset(self._rngs, ended)
        return observation, reward, terminated, truncated, infos


class LeanEnv(_OneRobot):
    """Drives the base in follow-me while people lean on the cover; the reward is to stay near the start, untouched."""

    _task = _LEAN


class LeanVectorEnv(_ManyRobots):
    """Many robots of `LeanEnv`."""

    _task = _LEAN


class PushEnv(_OneRobot):
    """Leads the flange to a place while people push the base away; the reward is the distance left, negative."""

    _task = _PUSH


class PushVectorEnv(_ManyRobots):
    """Many robots of `PushEnv`."""

    _task = _PUSH


for _name in ("Lean", "Push"):
    gymnasium.register(
        f"moca/{_name}-v0", entry_point=f"moca.gym:{_name}Env", vector_entry_point=f"moca.gym:{_name}VectorEnv"
    )
