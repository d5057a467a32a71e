"""Checks a robot's URDF with a library that is not ours: PyPI `pin`, which is Pinocchio (pip install pin mcap).

usage: foreign_urdf.py URDF LOG

For every state in a log of the same robot, Pinocchio's flange from the log's joint angles and base pose is compared with the
flange that the daemon wrote beside them; a log's numbers have seven digits, hence the limit. Exits non-zero beyond it, or if
joints, frames or masses are missing. The comparison to 1e-9, kinematics and mass matrix, is a test of the daemon's against
what this library says of the same file (tests/fixtures/urdf).
"""

import json
import math
import sys

import numpy
import pinocchio
from mcap.reader import make_reader

LIMIT_M = 2e-6

model = pinocchio.buildModelFromUrdf(sys.argv[1])
data = model.createData()
flange = model.getFrameId("flange")
assert flange < model.nframes, "no flange"
assert sum(inertia.mass for inertia in model.inertias) > 10.0, "an arm without mass"

worst, states = 0.0, 0
with open(sys.argv[2], "rb") as stream:
    for _, _, message in make_reader(stream).iter_messages(topics=["/state"]):
        state = json.loads(message.data)
        q = numpy.array(state["q_rad"])
        assert len(q) == model.nq, f"{len(q)} angles for {model.nq} joints"
        pinocchio.framesForwardKinematics(model, data, q)
        x, y, yaw = state["base_pose_world"]
        at = data.oMf[flange].translation
        cos, sin = math.cos(yaw), math.sin(yaw)
        world = [x + cos * at[0] - sin * at[1], y + sin * at[0] + cos * at[1], at[2]]
        worst = max(worst, math.dist(world, state["flange_position_world"]))
        states += 1
assert states > 0, "the log has no states"
print(f"{states} states of {model.name}: flange at most {worst:.1e} m from Pinocchio's")
assert worst < LIMIT_M
