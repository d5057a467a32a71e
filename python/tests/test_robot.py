import subprocess
import textwrap
import threading
import time

import numpy as np
import pytest

import moca
from conftest import ROOT, wait_for


def test_states_come_tick_by_tick_as_arrays(daemon):
    robot = moca.connect(daemon)
    states = [next(robot) for _ in range(200)]
    ticks = [state.tick for state in states]
    # A tick that is missing is one that the loop itself missed and counted.
    missed = [state.overruns - states[0].overruns for state in states]
    assert ticks == [ticks[0] + i + overruns for i, overruns in enumerate(missed)]
    assert states[0].q_rad.shape == (7,) and states[0].q_rad.dtype == np.float64
    assert states[0].taxel_force_n.shape == (0,)
    with pytest.raises(AttributeError):
        states[0].no_such_field


def test_the_program_of_the_readme_runs(daemon):
    text = (ROOT / "python/README.md").read_text()
    program = text.split("```python\n")[1].split("```")[0]
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    start = robot.state.flange_position_world[0]
    program = program.replace("connect()", f'connect("{daemon}")').replace("0.7", str(start + 0.02))
    assert len(program.splitlines()) == 5
    exec(program, {})
    wait_for(robot, "ready")
    assert robot.state.flange_position_world[0] > start + 0.015


def test_parameters_are_read_changed_and_refused(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    assert robot.parameters["control.gains.damping_ratio"].shape == (1,)
    robot.set_parameter("control.gains.damping_ratio", [0.8])
    until = time.monotonic() + 10
    while robot.parameters["control.gains.damping_ratio"][0] != 0.8:
        assert time.monotonic() < until
    with pytest.raises(ValueError, match="outside"):
        robot.set_parameter("control.gains.damping_ratio", [70.0])


def test_only_one_program_commands(daemon):
    first, second = moca.connect(daemon), moca.connect(daemon)
    wait_for(first, "ready")
    first.arm()
    wait_for(first, "impedance")
    with pytest.raises(moca.Refused, match="another client"):
        second.target_twist([0.05, 0, 0, 0, 0, 0])
    second.stop()
    wait_for(first, "protective stop")


def test_a_program_that_makes_no_call_loses_the_command(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    robot.arm()
    wait_for(robot, "impedance")
    # Its threads run on, the connection's among them; but nobody calls.
    threading.Event().wait(4.0)
    assert wait_for(robot, "protective stop").fault is not None


def test_a_second_thread_stops_the_robot_while_the_first_one_waits(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    robot.arm()
    wait_for(robot, "impedance")
    failed = []

    def stop():
        try:
            for _ in range(20):
                robot.stop()
        except BaseException as error:
            failed.append(error)

    second = threading.Thread(target=stop)
    second.start()
    for state in robot:
        if state.mode == "protective stop" and not second.is_alive():
            break
    second.join()
    assert failed == []


def test_each_thread_gets_the_answer_to_what_it_asked(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    wrong = []

    def ask(call, refused):
        for _ in range(100):
            try:
                call()
                answer = None
            except moca.Refused as error:
                answer = str(error)
            if (answer is not None) != refused:
                wrong.append(answer)

    # The first is taken in this mode, the second is not.
    calls = [(lambda: robot.select_law("impedance"), False), (lambda: robot.target_twist([0.0] * 6), True)]
    threads = [threading.Thread(target=ask, args=call) for call in calls]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_leaving_the_block_disarms(daemon):
    second = moca.connect(daemon)
    with moca.connect(daemon) as first:
        wait_for(first, "ready")
        first.arm()
        wait_for(first, "impedance")
    with pytest.raises(moca.Disconnected, match="closed"):
        first.state
    wait_for(second, "ready")


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_exception_that_leaves_the_block_is_a_protective_stop(daemon, error):
    second = moca.connect(daemon)
    with pytest.raises(error):
        with moca.connect(daemon) as first:
            wait_for(first, "ready")
            first.arm()
            wait_for(first, "impedance")
            raise error
    assert wait_for(second, "protective stop").fault is not None


def test_exception_of_a_program_that_only_looks_on_stops_no_robot(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    robot.arm()
    wait_for(robot, "impedance")
    with pytest.raises(ValueError):
        with moca.connect(daemon) as onlooker:
            wait_for(onlooker, "impedance")
            raise ValueError
    with moca.connect(daemon) as onlooker:
        wait_for(onlooker, "impedance")
    robot.end_target()
    assert {next(robot).mode for _ in range(1000)} == {"impedance"}


def test_release_disarms(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    robot.arm()
    wait_for(robot, "impedance")
    robot.release()
    wait_for(robot, "ready")


def test_anybody_stops_without_a_connection(daemon):
    robot = moca.connect(daemon)
    wait_for(robot, "ready")
    robot.arm()
    wait_for(robot, "impedance")
    moca.stop(daemon)
    wait_for(robot, "protective stop")


def test_a_taxel_that_there_is_none_of_is_named(daemon):
    robot = moca.connect(daemon)
    with pytest.raises(ValueError, match="taxel 0: allowed: 1"):
        robot.press(0, 1.0)


def test_without_a_daemon_it_says_so():
    with pytest.raises(moca.Disconnected, match="no/such/socket"):
        moca.connect("unix:/no/such/socket")


def test_certificate_of_an_operator_commands_over_tls(distant):
    with moca.connect(distant("lab-pc", "operator")) as robot:
        wait_for(robot, "ready")
        robot.arm()
        wait_for(robot, "impedance")
        robot.stop()
        wait_for(robot, "protective stop")


def test_certificate_of_a_viewer_watches_and_stops_only(distant):
    address = distant("screen", "viewer")
    robot = moca.connect(address)
    wait_for(robot, "ready")
    with pytest.raises(moca.Refused, match="a certificate of a higher role"):
        robot.arm()
    moca.stop(address)
    wait_for(robot, "protective stop")


def test_without_a_certificate_it_says_which_file_is_missing(distant, monkeypatch):
    address = distant("lab-pc", "operator")
    monkeypatch.setenv("MOCA_ACCESS_FILE", "/no/such/certificate.pem")
    with pytest.raises(moca.Disconnected, match="/no/such/certificate.pem"):
        moca.connect(address)


def test_program_of_the_tutorial_leads_a_robot_that_armed_itself(mocad, tmp_path):
    address, config = f"unix:{tmp_path}/mocad.sock", tmp_path / "mocad.toml"
    config.write_text(f'plant.parts = "arm"\n[telemetry]\nlisten = "{address}"\n')
    process = subprocess.Popen([mocad, "--config", config], stdout=subprocess.DEVNULL)
    tutorial = (ROOT / "docs/tutorials/python.md").read_text()
    program = textwrap.dedent(tutorial.split("```python\n")[1].split("```")[0])
    assert "moca.connect()" in program
    try:
        with moca.connect(address) as robot:
            start = wait_for(robot, "impedance").flange_position_world
        exec(program.replace("moca.connect()", f"moca.connect({address!r})"), {})
        with moca.connect(address) as robot:
            assert next(robot).flange_position_world[1] > start[1] + 0.002
    finally:
        process.kill()
        process.wait(60)
