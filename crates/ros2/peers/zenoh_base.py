"""A base over rmw_zenoh, by zenoh-ros2-sdk, and the router of both ends:

    python zenoh_base.py PORT
"""
import math
import signal
import sys
import time

import numpy as np

from motion import Motion
from zenoh_messages import (
    HEADER, ODOMETRY, POINT, POSE, POSES, QUATERNION, STAMPED, TIME, TWIST, TWISTS, VECTOR, definition, type_hash)


class ZenohBase(Motion):
    """`kind` and `kind_hash` are what it wants on cmd_vel where that is not what it should want."""

    def __init__(self, port, stamped, kind=None, kind_hash=None, domain=7, cmd_vel="/robot/cmd_vel", odom="/robot/odom"):
        from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
        super().__init__(stamped)
        kind, where = kind or (STAMPED if stamped else TWIST), dict(node_name="base_control", domain_id=domain, router_port=port)
        self.unread = []
        self.reader = ROS2Subscriber(
            cmd_vel, kind, self.unread.append, msg_definition=definition(kind), type_hash=kind_hash or type_hash(kind), **where)
        self.writer = ROS2Publisher(odom, ODOMETRY, msg_definition=definition(ODOMETRY), type_hash=type_hash(ODOMETRY), **where)
        self.types = self.writer.session_mgr.store.types

    def orders(self):
        taken, self.unread[:] = list(self.unread), []
        return taken

    def tell(self, ns, pose, velocity):
        def made(name, **fields):
            return self.types[name](**fields)
        x, y, yaw = velocity
        half = pose[2] / 2
        place = made(POSE, position=made(POINT, x=pose[0], y=pose[1], z=0.0),
                     orientation=made(QUATERNION, x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)))
        twist = made(TWIST, linear=made(VECTOR, x=x, y=y, z=0.0), angular=made(VECTOR, x=0.0, y=0.0, z=yaw))
        self.writer.publish(
            header=made(HEADER, stamp=made(TIME, sec=ns // 10**9, nanosec=ns % 10**9), frame_id="odom"), child_frame_id="base_link",
            pose=made(POSES, pose=place, covariance=np.zeros(36)), twist=made(TWISTS, twist=twist, covariance=np.zeros(36)))


def route(port):
    """A router as rmw_zenohd is one."""
    import zenoh
    config = zenoh.Config()
    for key, value in (("mode", '"router"'), ("listen/endpoints", f'["tcp/127.0.0.1:{port}"]'), ("scouting/multicast/enabled", "false")):
        config.insert_json5(key, value)
    session = zenoh.open(config)
    print("routes", session.zid(), flush=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    while True:
        time.sleep(1)


if __name__ == "__main__":
    route(int(sys.argv[1]))
