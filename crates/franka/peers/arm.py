"""franka-sim, whose states say besides what standard input asks for: a line of JSON, such as {"robot_mode": 5, "m_ee": 0.7}, with
"errors" as the numbers of flags and "skip" as the states that are left out before each one. Arguments are run-franka-sim-server's.
"""
import json
import sys
import threading

from franka_sim.robot_state import RobotState
from franka_sim.run_server import main

asked = {}
pack, update = RobotState.pack_state, RobotState.update


def pack_state(self):
    was = dict(self.state)
    self.state.update({name: value for name, value in asked.items() if name not in ("errors", "skip")})
    if "errors" in asked:
        self.state["errors"] = [flag in asked["errors"] for flag in range(41)]
    try:
        return pack(self)
    finally:
        self.state.update({name: was[name] for name in was if name in asked})


def skip(self):
    for _ in range(1 + asked.get("skip", 0)):
        update(self)


def listen():
    for line in sys.stdin:
        asked.clear()
        asked.update(json.loads(line))


RobotState.pack_state, RobotState.update = pack_state, skip
threading.Thread(target=listen, daemon=True).start()
main()
