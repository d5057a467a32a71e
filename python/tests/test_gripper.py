import math
import signal
import threading
import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest

import moca
from conftest import CALM, ROOT, running, wait_for

BOX = 'gripper = "simulated"\n[simulation.true.object]\nmass_kg = 0.5\nsize_m = 0.05\n'
GRIPPER = f"{CALM}plant.gripper = \"simulated\"\nsimulation.true.object.mass_kg = "
BLOCKED = "Something stopped the fingers on their way."


def sim(mass_kg=0.5):
    """A robot with a cube of 50 mm between its fingers, or without it."""
    return moca.Sim(f"{GRIPPER}{mass_kg}\n")


@pytest.fixture(params=["sim", "robot"])
def gripping(request):
    """A simulated robot, and a live one, each with a cube of 50 mm between its fingers."""
    if request.param == "sim":
        return sim()
    address = request.getfixturevalue("box")
    return moca.connect(address)


@pytest.fixture
def box(mocad, tmp_path):
    """Address of a live robot with a cube of 50 mm between its fingers."""
    with running(mocad, tmp_path, BOX) as (address, _):
        yield address


def rest(robot):
    """Lets 0.1 s of the robot's time pass: a log has 50 rows a second."""
    until_s = robot.state.time_s + 0.1
    while robot.state.time_s < until_s:
        pass


@contextmanager
def interrupted(after_s):
    """Ctrl-C after a time."""
    handler = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, after_s)
        with pytest.raises(KeyboardInterrupt):
            yield
    finally:
        signal.signal(signal.SIGALRM, handler)


def test_grasp_move_and_release_tell_what_is_held(gripping):
    gripper = gripping.gripper
    assert gripper.state == (0.08, 0.08, "resting", False, 0.0, None)
    assert gripper.grasp(0.05, speed_m_s=0.1, mass_kg=0.5) is True
    assert gripper.state == (pytest.approx(0.05), 0.08, "holding", True, 0.5, None)
    gripper.stop()
    assert gripper.state.holds, "a stop of the fingers lets nothing go"
    assert gripper.move(0.06, 0.1) is None
    assert gripper.state == (pytest.approx(0.06), 0.08, "resting", False, 0.0, None)
    gripper.release()
    assert gripper.state == (pytest.approx(0.08), 0.08, "resting", False, 0.0, None)
    # The cube stands between the fingers.
    with pytest.raises(moca.Refused, match=BLOCKED):
        gripper.home()
    assert gripper.state.width_m == pytest.approx(0.05)


def test_home_opens_and_closes_and_opens():
    robot = sim(0)
    robot.gripper.home(wait=False)
    widths = [robot.step(10).gripper_width_m for _ in range(400)]
    assert min(widths) < 1e-3 and widths[-1] == pytest.approx(0.08) and robot.gripper.state.phase == "resting"


def test_grasp_without_an_object_is_false_and_the_fault_says_why(gripping):
    assert gripping.gripper.grasp(0.02, 0.1, tolerance_m=0.01) is False
    assert gripping.gripper.state.fault.startswith("The object is wider than asked. Ask for the object's width")
    with pytest.raises(moca.Refused, match=BLOCKED):
        gripping.gripper.move(0.0)
    assert sim(0).gripper.grasp(0.05) is False


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda gripper: gripper.move(0.09), "width of the gripper = 0.09 m; allowed: 0 to 0.08 m"),
        (lambda gripper: gripper.move(math.nan), "width of the gripper = NaN m; allowed: 0 to 0.08 m"),
        (lambda gripper: gripper.move(0.0, 0.2), "speed of the gripper = 0.2 m/s; allowed: 0.001 to 0.1 m/s"),
        (lambda gripper: gripper.grasp(0.05, force_n=0), "force of the gripper = 0 N; allowed: 1 to 70 N"),
        (lambda gripper: gripper.grasp(0.05, tolerance_m=-1), "tolerance of the gripper = -1 m; allowed: 0.0001 to 0.08 m"),
        (lambda gripper: gripper.grasp(0.05, mass_kg=9), "mass of the object = 9 kg; allowed: 0 to 2.27 kg"),
    ],
)
def test_number_out_of_range_is_refused_and_changes_nothing(ask, said):
    robot = sim()
    assert robot.gripper.grasp(0.05)
    before = robot.gripper.state
    with pytest.raises(moca.Refused, match=said):
        ask(robot.gripper)
    assert robot.gripper.state == before


def test_daemon_refuses_at_once_and_nan_too(box):
    robot = moca.connect(box)
    for width_m in (0.09, math.nan):
        with pytest.raises(moca.Refused, match=r"width of the gripper = (0.09|NaN) m; allowed: 0 to 0.08 m"):
            robot.gripper.grasp(width_m)
    with pytest.raises(moca.Refused, match="not possible in mode|not a finite number"):
        robot.target_twist([math.nan] * 6)
    with pytest.raises(TypeError):
        robot.gripper.grasp("wide")


def test_robot_without_gripper_says_what_to_set(daemon):
    for robot in (moca.Sim(CALM), moca.connect(daemon)):
        for ask in (lambda: robot.gripper.grasp(0.05), lambda: robot.gripper.state):
            with pytest.raises(moca.Refused, match="the robot has no gripper: set plant.gripper"):
                ask()
    state = moca.Sim(CALM).step()
    assert state.gripper is None and math.isnan(state.gripper_width_m) and math.isnan(state.gripper_object_kg)


def test_request_without_waiting_moves_while_the_caller_steps():
    waiting, stepping = sim(), sim()
    assert waiting.gripper.grasp(0.05, mass_kg=0.5)
    assert stepping.gripper.grasp(0.05, mass_kg=0.5, wait=False) is False
    assert stepping.gripper.state.phase == "moving"
    while (state := stepping.step()).gripper.phase == "moving":
        pass
    assert state.gripper == stepping.gripper.state == waiting.gripper.state
    assert state.gripper_width_m == state.gripper.width_m and state.gripper_object_kg == 0.5
    # 30 mm at 50 mm/s; the request took the first tick.
    assert state.tick == pytest.approx(600, abs=2)
    both = [robot.step() for robot in (waiting, stepping)]
    assert both[0].tick == both[1].tick and np.array_equal(both[0].q_rad, both[1].q_rad)


def test_robot_returns_before_the_fingers_rest_if_told_to(box):
    robot = moca.connect(box)
    assert robot.gripper.grasp(0.05, 0.001, wait=False) is False
    assert robot.gripper.state.phase == "moving", "its state knows of the request"
    robot.gripper.move(0.079, wait=False)
    until = time.monotonic() + 60
    while robot.gripper.state.phase == "moving":
        assert time.monotonic() < until
    assert robot.state.gripper.width_m == pytest.approx(0.079)


def test_interrupted_request_stops_the_fingers(gripping):
    gripping.gripper.move(0.08)
    # It takes 30 s of the robot's time to reach the cube.
    after_s = 0.5 if isinstance(gripping, moca.Robot) else 0.05
    with interrupted(after_s):
        gripping.gripper.grasp(0.01, speed_m_s=0.001)
    state = gripping.gripper.state
    assert state.phase == "resting" and 0.05 < state.width_m < 0.08 and state.fault is None


def test_object_stays_held_when_the_program_ends(box):
    with moca.connect(box) as robot:
        assert robot.gripper.grasp(0.05, 0.1)
    with pytest.raises(ValueError):
        with moca.connect(box) as robot:
            assert robot.gripper.state.holds
            robot.gripper.stop()
            raise ValueError
    assert moca.connect(box).gripper.state.holds


def test_only_the_program_with_the_command_moves_the_fingers(box):
    first, second = moca.connect(box), moca.connect(box)
    first.gripper.move(0.07)
    with pytest.raises(moca.Refused, match="another client"):
        second.gripper.release()
    first.release()
    until = time.monotonic() + 60
    while second.gripper.state.width_m < 0.08:
        assert time.monotonic() < until
        with suppress(moca.Refused):
            second.gripper.release()


def test_another_thread_stops_fingers_that_are_waited_for(box):
    robot = moca.connect(box)
    wait_for(robot, "ready")
    robot.arm()
    wait_for(robot, "impedance")
    first, ended = next(robot), []

    def move():
        robot.gripper.move(0.0, 0.001)
        ended.append(True)

    moving = threading.Thread(target=move)
    moving.start()
    # Longer than a program may be silent, with the fingers' thread as its only sign of life.
    time.sleep(4.0)
    assert robot.gripper.state.phase == "moving" and not ended
    robot.gripper.stop()
    moving.join(60)
    assert ended == [True] and robot.gripper.state.phase == "resting"
    then = next(robot)
    assert then.mode == "impedance"
    assert then.tick - first.tick == 1 + then.overruns - first.overruns, "no state was taken from whoever reads them"


def test_silent_gripper_is_an_error_and_not_an_object_missed(mocad, tmp_path):
    with running(mocad, tmp_path, BOX, ["--inject", "gripper-unplugged@5"]) as (address, _):
        robot = moca.connect(address)
        with pytest.raises(moca.Refused, match="gripper does not answer"):
            robot.gripper.grasp(0.01, 0.001)
        assert robot.gripper.state.phase == "unknown"
        with pytest.raises(moca.Refused, match="the gripper does not answer: check its plug and power, then ask again"):
            robot.gripper.stop()


def test_log_has_the_grippers_columns(mocad, tmp_path):
    path = tmp_path / "run.mcap"
    with running(mocad, tmp_path, BOX, ["--record", path]) as (address, process):
        with moca.connect(address) as robot:
            assert robot.gripper.grasp(0.05, mass_kg=0.5)
            rest(robot)
            robot.gripper.release()
            assert not robot.gripper.grasp(0.02)
            rest(robot)
        process.send_signal(signal.SIGINT)
        process.wait(60)
    log = moca.read(path)
    width_m, object_kg, phase = log["gripper_width_m"], log["gripper_object_kg"], log["gripper_phase"]
    assert set(phase) == {"resting", "moving", "holding"}
    assert set(object_kg[phase == "holding"]) == {0.5} and not object_kg[phase != "holding"].any()
    assert np.allclose(width_m[phase == "holding"], 0.05) and width_m.max() == pytest.approx(0.08)
    assert list(dict.fromkeys(log["gripper_fault_code"])) == ["", "object-too-large"]


def test_gripper_of_the_readme_holds():
    program = (ROOT / "python/README.md").read_text().split("```python\n")[2].split("```")[0]
    names = {"moca": moca}
    exec(program, names)
    assert names["sim"].gripper.state.holds


def test_batch_shows_the_fingers_and_takes_no_request_for_them():
    batch = moca.SimBatch(f"{GRIPPER}0.5\n", robots=2)
    states = batch.reset([1, 2])
    assert np.allclose(states.gripper_width_m, 0.08) and not states.gripper_object_kg.any()
    assert not hasattr(batch, "gripper")
