"""Picks up a box and hands it over while somebody leans on the robot.

Start the simulated robot first: mocad --config examples/hand-over/robot.toml
Arguments: the robot's address; without one, this machine's.
"""

import sys
import time

import numpy as np

import moca


def go(robot, position_m, within_s=60.0):
    """Leads the flange to a place in the world, m. A touch sets the target aside and does not end it."""
    state = robot.state
    quaternion = state.flange_desired_quaternion_world
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        robot.target_pose(position_m, quaternion, touch="pass-through")
        state = robot.state
        off_m = np.linalg.norm(state.flange_desired_position_world - position_m)
        if state.fault:
            raise SystemExit(f"the robot stopped: {state.fault}")
        if off_m < 1e-3:
            return
        time.sleep(0.02)
    raise SystemExit(f"the flange is not at {position_m} m after {within_s} s")


def main(address=None):
    with moca.connect(address) as robot:
        robot.arm()
        go(robot, [0.70, 0.00, 1.05])  # above the box
        go(robot, [0.70, 0.00, 0.9034])  # the fingertips are 0.1034 m beyond the flange
        if not robot.gripper.grasp(0.05, force_n=40.0, mass_kg=0.5):
            raise SystemExit(f"nothing was grasped: {robot.gripper.state.fault}")
        go(robot, [0.70, 0.00, 1.05])  # lifted: the law carries the 0.5 kg that it was told
        go(robot, [0.65, -0.30, 1.00])  # in front of the person
        print("Somebody takes the box.")
        robot.gripper.release()
        go(robot, [0.507, 0.00, 1.10])  # back


if __name__ == "__main__":
    main(*sys.argv[1:2])
