import signal

import numpy as np
import pytest

import moca
from conftest import CALM


def ready(law="impedance", **more):
    sim = moca.Sim(f'startup.law = "{law}"\n' + CALM, **more)
    for _ in range(30):
        state = sim.step(100)
        if state.mode not in ("starting", "taring", "ready"):
            return sim, state
    raise AssertionError(state)


def test_the_same_seed_gives_the_same_bits():
    runs = []
    for seed in (1, 1, 2):
        sim, _ = ready(seed=seed)
        sim.press(6, 15.0)
        runs.append(sim.step(500))
    assert np.array_equal(runs[0].q_rad, runs[1].q_rad)
    assert np.array_equal(runs[0].base_pose_world, runs[1].base_pose_world)
    assert not np.array_equal(runs[0].taxel_force_n, runs[2].taxel_force_n)


def test_a_pose_is_reached():
    sim, state = ready()
    wanted = state.flange_position_world + [0.03, 0.0, 0.05]
    for _ in range(100):
        sim.target_pose(wanted, state.flange_desired_quaternion_world)
        state = sim.step(19)
    assert state.target == ("pose", "reached") and state.target_progress == 1.0
    assert np.linalg.norm(state.flange_position_world - wanted) < 5e-3


def test_a_pressed_base_goes_as_fast_as_the_force_that_is_felt_and_the_damping_say():
    sim, state = ready("follow-me")
    assert np.abs(state.base_velocity_world).max() < 1e-3
    # From the left side, below the speed limit; from the front it goes no further than 0.1 m: no taxel covers its back.
    sim.press(3, 5.0)
    sim.step(1000)
    # Eq. (2) at rest, M being long over: D·v = F, D = 80 N·s/m.
    states = [sim.step(10) for _ in range(100)]
    speed = np.mean([np.hypot(*state.base_velocity_world[:2]) for state in states])
    force = np.mean([state.taxel_force_n[2] for state in states])
    assert force > 2.0 and speed == pytest.approx(force / 80.0, rel=0.02)
    assert max(state.cover_speed_m_s for state in states) < states[-1].speed_limit_m_s
    assert states[-1].base_pose_world[1] < -0.05


def test_a_refusal_says_why_with_value_and_range():
    sim, state = ready()
    with pytest.raises(moca.Refused, match=r"linear speed x = 0.5\d* m/s is outside -0.25"):
        sim.target_twist([0.5, 0, 0, 0, 0, 0])
    with pytest.raises(moca.Refused, match="not a finite number"):
        sim.target_pose([np.nan, 0, 0], [0, 0, 0, 1])
    with pytest.raises(moca.Refused, match="choose follow-me"):
        sim.target_base([0.1, 0, 0])
    with pytest.raises(ValueError, match="1 numbers for a twist in m/s and rad/s: 6 are needed"):
        sim.target_twist([0.1])
    with pytest.raises(ValueError):
        moca.Sim("no.such.key = 1\n")


def test_a_trajectory_runs_to_its_end():
    sim, state = ready()
    p, q = state.flange_desired_position_world, state.flange_desired_quaternion_world
    sim.trajectory([0, 1, 2], [p, p + [0, 0.05, 0], p], [q, q, q])
    assert 0.4 < sim.step(1000).target_progress < 0.6
    assert sim.step(1500).target == ("trajectory", "reached")


def test_a_long_step_is_interrupted():
    sim, _ = ready()
    handler = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt):
            sim.step(10**9)
    finally:
        signal.signal(signal.SIGALRM, handler)
    assert sim.step(1).mode == "impedance"


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda sim: sim.press(99, 10.0), r"taxel 99: allowed: 1 \(T1\) to 11 \(T11\)"),
        (lambda sim: sim.press(1, 999.0), "force 999 N: allowed: 0 .* to 200 N"),
        (lambda sim: sim.press(1, float("nan")), "force NaN N: allowed"),
        (lambda sim: sim.select_law("fast"), "allowed: 'impedance', 'follow-me'"),
        (lambda sim: sim.target_twist([0.0] * 6, axes="tool"), "allowed: 'world', 'base', 'flange'"),
        (lambda sim: sim.target_twist([0.0] * 6, touch="ignore"), 'allowed: "wins", "pass-through"'),
        (lambda sim: sim.target_posture([0.0] * 99), "99 joint angles in rad: allowed: 1 to"),
        (lambda sim: sim.trajectory([], [], []), "0 poses of a trajectory: allowed: 1 to 32"),
        (lambda sim: sim.trajectory(range(33), [[0.0] * 3] * 33, [[0.0] * 4] * 33), "33 poses of a trajectory: allowed: 1 to 32"),
        (lambda sim: sim.trajectory([1.0], [[0.0] * 3] * 2, [[0.0] * 4]), "1 times, 2 positions, 1 quaternions: a trajectory needs"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(call, said):
    with pytest.raises(ValueError, match=said):
        call(moca.Sim(CALM))


def test_a_refusal_says_what_to_do_first():
    sim, _ = ready()
    sim.disarm()
    with pytest.raises(moca.Refused, match="not possible in mode ready: arm first"):
        sim.target_twist([0.0] * 6)


def test_a_missing_configuration_is_a_file_that_is_not_found():
    with pytest.raises(FileNotFoundError, match="no-such.toml"):
        moca.Sim("/nowhere/no-such.toml")
