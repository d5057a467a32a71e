"""A Gymnasium environment: drive the base of a robot in follow-me while somebody leans on its cover."""

import gymnasium as gym
import numpy as np

import moca


class LeanEnv(gym.Env):
    action_space = gym.spaces.Box(-1.0, 1.0, (3,), np.float64)
    observation_space = gym.spaces.Box(-np.inf, np.inf, (17,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.sim = moca.Sim('startup.law = "follow-me"\nsimulation.hand.taxels = []\n', seed=seed)
        for _ in range(1000):
            if (state := self.sim.step(10)).mode == "follow-me":
                return self._observation(state), {}
        raise RuntimeError(f"{state.mode} after {state.time_s} s: {state.fault}")

    def step(self, action):
        if self.np_random.random() < 0.05:
            self.sim.press(int(self.np_random.integers(1, 12)), float(self.np_random.choice([0.0, 10.0])))
        self.sim.target_base(np.clip(action, -1, 1) * [0.2, 0.2, 0.5])
        state = self.sim.step(19)
        reward = 1.0 - np.linalg.norm(state.base_pose_world[:2]) - 0.05 * np.nansum(state.taxel_force_n)
        return self._observation(state), float(reward), state.fault is not None, state.time_s > 30, {}

    def _observation(self, state):
        return np.concatenate([state.base_pose_world, state.base_velocity_world, np.nan_to_num(state.taxel_force_n)])
