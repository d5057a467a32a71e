import threading
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import moca
import moca.gym
from conftest import CALM

FOLLOW = 'startup.law = "follow-me"\n' + CALM


def in_control(seed):
    sim = moca.Sim(FOLLOW, seed=seed)
    while (state := sim.step(1)).mode != "follow-me":
        pass
    return sim, state


def same(states, index, state):
    """Bits of every field, NaN and all."""
    return all(
        getattr(states, name)[index].tobytes() == np.asarray(getattr(state, name), np.float64).tobytes()
        for name, _ in moca._moca.State.fields()
    )


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_batch_equals_sim_bit_for_bit_with_resets(threads):
    robots, ticks = 3, 20
    rng = np.random.default_rng(threads)
    batch = moca.SimBatch(FOLLOW, robots, threads)
    alone = [in_control(seed) for seed in range(robots)]
    states = batch.reset(range(robots))
    assert all(same(states, i, state) for i, (_, state) in enumerate(alone))
    for step in range(10_000 // ticks):
        targets = rng.uniform(-0.2, 0.2, (robots, 3))
        targets[rng.random(robots) < 0.2] = np.nan
        presses = np.column_stack([rng.integers(0, 12, robots), rng.uniform(0, 12, robots)])
        states = batch.step(targets, ticks, presses)
        for i, (sim, _) in enumerate(alone):
            left = ticks
            refused = None
            if presses[i, 0]:
                sim.press(int(presses[i, 0]), presses[i, 1])
                left -= 1
            if not np.isnan(targets[i, 0]):
                try:
                    sim.target_base(targets[i])
                except moca.Refused as refusal:
                    refused = str(refusal)
                left -= 1
            state = sim.step(left)
            assert states.refused[i] == refused
            assert same(states, i, state) and states.mode[i] == state.mode and states.fault[i] == state.fault
        if step % 50 == 49:
            again = rng.random(robots) < 0.7
            seeds = rng.integers(1000, size=robots)
            states = batch.reset(seeds, where=again)
            for i in np.flatnonzero(again):
                alone[i] = in_control(int(seeds[i]))
                assert same(states, i, alone[i][1])


def driven(text):
    sim = moca.Sim(text, seed=1)
    while sim.step(1).mode != "follow-me":
        pass
    sim.target_base([0.2, 0, 0])
    return sim.step(199)


def test_robot_has_settings_of_its_own():
    batch = moca.SimBatch(FOLLOW, 3, 2)
    late = {"true.base.servo_ms": 200.0, "m_v": 6}
    batch.reset([1, 1, 1], settings=[{}, late, late])
    states = batch.step([[0.2, 0, 0]] * 3, 200)
    config = FOLLOW + "simulation.true.base.servo_ms = 200.0\ncontrol.gains.virtual_mass = [6.0, 6.0, 2.0]\n"
    for i, text in enumerate([FOLLOW, config, config]):
        assert same(states, i, driven(text)), i
    assert states.base_pose_world[0, 0] > states.base_pose_world[1, 0] + 0.001
    # What a reset leaves out is as the configuration has it.
    states = batch.reset([1, 1, 1], where=[False, True, False])
    assert same(batch.step([[0.2, 0, 0]] * 3, 200), 1, driven(FOLLOW))


def test_states_share_memory_and_are_read_only():
    batch = moca.SimBatch(FOLLOW, 2, 1)
    assert np.isnan(batch.states.base_pose_world).all() and batch.states.mode == [None, None]
    states = batch.reset([1, 2])
    pose = states.base_pose_world
    before = pose.copy()
    batch.step([[0.1, 0, 0]] * 2, 200)
    assert pose is batch.states.base_pose_world and (pose[:, 0] > before[:, 0]).all()
    with pytest.raises(ValueError, match="read-only"):
        pose[0, 0] = 1.0
    del batch, states
    assert np.isfinite(pose).all()


def test_other_threads_run_while_robots_step():
    for step in (moca.Sim(CALM).step, moca.SimBatch(CALM, 2, 1)):
        if isinstance(step, moca.SimBatch):
            step.reset([0, 1])
            step = lambda ticks, batch=step: batch.step(ticks=ticks)
        count, stop = 0, threading.Event()

        def other():
            nonlocal count
            while not stop.is_set():
                count += 1

        thread = threading.Thread(target=other)
        thread.start()
        before = count
        step(1000)
        during = count - before
        stop.set()
        thread.join()
        assert during > 0


def test_robot_that_refuses_steps_on_and_says_why():
    batch = moca.SimBatch(FOLLOW, 3, 2)
    before = batch.reset([1, 2, 3]).time_s.copy()
    states = batch.step([[0, 0, 0], [9, 0, 0], [0.1, np.nan, 0]], 10)
    assert np.allclose(states.time_s - before, 0.010)
    assert states.refused[0] is None and "outside -3.000000 to 3.000000" in states.refused[1]
    assert "not a finite number" in states.refused[2]
    assert batch.step(ticks=10).refused == [None] * 3


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: moca.SimBatch(CALM, 0), "robots = 0: allowed: 1 to"),
        (lambda: moca.SimBatch(CALM, 2, 3), "threads = 3: allowed: 1 to the number of robots, 2"),
        (lambda: moca.SimBatch(CALM, target="arm"), 'no target is called "arm"'),
        (lambda: moca.SimBatch(CALM).step(), "robot 0 has no state yet: reset it first"),
        (lambda: ready().step(ticks=0), "ticks = 0: allowed: 1 or more"),
        (lambda: ready().step([[0, 0, 0]], 1, [[1, 5]]), "ticks = 1: allowed: 2 or more, one for each request"),
        (lambda: ready().step(ticks=1, presses=[[12, 5]]), r"robot 0, taxel 12: allowed: 1 \(T1\) to 11 \(T11\), 0 for none"),
        (lambda: ready().step(ticks=1, presses=[[1, 999]]), "force 999 N: allowed"),
        (lambda: ready().reset([1], settings=[{"m_v": -1}]), "robot 0: --set m_v=-1.*outside 0.01 to 1000"),
        (lambda: ready().reset([1], settings=[{"mass": 1}]), "robot 0: --set: unknown key mass"),
        (lambda: ready().reset([1], settings=[{"person.mass": 9}]), "person.mass=9: only an experiment has this"),
        (lambda: ready().reset([1], settings=[{}, {}]), "1 seeds and 2 settings for 1 robots"),
        (lambda: moca.gym.PushVectorEnv(random={"normal": {}}), r"random: \['normal'\]: allowed: uniform, log"),
    ],
)
def test_wrong_value_is_named_with_its_range(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def ready():
    batch = moca.SimBatch(FOLLOW)
    batch.reset([1])
    return batch


def test_robot_that_does_not_arm_is_refused():
    with pytest.raises(RuntimeError, match="robot is ready after 10 s: a batch needs startup.arm = true"):
        moca.SimBatch("startup.arm = false\n" + CALM)


RANDOM = {"uniform": {"true.foam.scale": (0.7, 1.3)}, "log": {"m_v": (2, 8)}}


@pytest.mark.parametrize(("name", "random"), [("Lean", None), ("Push", None), ("Push", RANDOM)])
def test_vector_environment_equals_lone_ones(name, random):
    many = gymnasium.make_vec(f"moca/{name}-v0", num_envs=3, random=random)
    alone = [gymnasium.make(f"moca/{name}-v0", disable_env_checker=True, random=random) for _ in range(3)]
    seen, _ = many.reset(seed=7)
    for i, env in enumerate(alone):
        assert np.array_equal(seen[i], env.reset(seed=7 + i)[0])
    rng = np.random.default_rng(0)
    for _ in range(50):
        actions = rng.uniform(-1, 1, (3, 3))
        seen, reward, *_ = many.step(actions)
        for i, env in enumerate(alone):
            lone, its, *_ = env.step(actions[i])
            assert np.array_equal(seen[i], lone) and reward[i] == its


def test_ended_episode_starts_again_in_the_same_step(monkeypatch):
    task = moca.gym.LeanVectorEnv._task
    monkeypatch.setattr(moca.gym.LeanVectorEnv, "_task", task._replace(episode_s=2.0))
    env = gymnasium.make_vec("moca/Lean-v0", num_envs=2)
    env.reset(seed=1)
    for _ in range(200):
        seen, _, _, truncated, infos = env.step(np.zeros((2, 3)))
        if truncated.any():
            break
    assert truncated.all() and infos["_final_obs"].all()
    assert not np.array_equal(infos["final_obs"][0], seen[0])
    assert (env.unwrapped._robots.batch.states.time_s < 2.0).all()


def test_observation_and_command_are_those_of_a_running_robot():
    env = moca.gym.PushEnv()
    seen, _ = env.reset(seed=3)
    lone = env._robots.batch.states
    state = SimpleNamespace(**{name: getattr(lone, name)[0] for name in vars(lone) if not name.startswith("_")})
    assert np.array_equal(env.observe(state), seen)
    assert env.command([0.5, 2.0, -3.0]).tolist() == [0.05, 0.1, -0.1, 0, 0, 0]


@pytest.mark.parametrize("env", [moca.gym.LeanEnv, moca.gym.PushEnv])
def test_environment_follows_the_interface(env):
    check_env(env(), skip_render_check=True)
