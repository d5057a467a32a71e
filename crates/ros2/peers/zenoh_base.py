"""A base over rmw_zenoh, by zenoh-ros2-sdk, and the router of both ends:

    python zenoh_base.py PORT
"""
import hashlib
import json
import math
import signal
import sys
import time

import numpy as np

from motion import Motion

TIME, HEADER, VECTOR = "builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3"
POSE, POINT, QUATERNION = "geometry_msgs/msg/Pose", "geometry_msgs/msg/Point", "geometry_msgs/msg/Quaternion"
TWIST, STAMPED, ODOMETRY = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry"
POSES, TWISTS = "geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/msg/TwistWithCovariance"
FIELDS = {
    TIME: "int32 sec\nuint32 nanosec",
    HEADER: f"{TIME} stamp\nstring frame_id",
    VECTOR: "float64 x\nfloat64 y\nfloat64 z",
    POINT: "float64 x\nfloat64 y\nfloat64 z",
    QUATERNION: "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    POSE: f"{POINT} position\n{QUATERNION} orientation",
    TWIST: f"{VECTOR} linear\n{VECTOR} angular",
    STAMPED: f"{HEADER} header\n{TWIST} twist",
    POSES: f"{POSE} pose\nfloat64[36] covariance",
    TWISTS: f"{TWIST} twist\nfloat64[36] covariance",
    ODOMETRY: f"{HEADER} header\nstring child_frame_id\n{POSES} pose\n{TWISTS} twist",
}


def used_by(name):
    """Every message within a message."""
    named = {word for word in FIELDS[name].split() if word in FIELDS}
    return named.union(*map(used_by, named))


NUMBERS = {"int32": 6, "uint32": 7, "float64": 11, "string": 17}


def described(name):
    """A message as REP-2016 describes it."""
    fields = []
    for line in FIELDS[name].splitlines():
        kind, field = line.split()
        kind, _, length = kind.partition("[")
        nested = kind if kind in FIELDS else ""
        fields.append({"name": field, "type": {
            "type_id": NUMBERS.get(kind, 1) + (48 if length else 0), "capacity": int(length.rstrip("]") or 0), "string_capacity": 0,
            "nested_type_name": nested}})
    return {"type_name": name, "fields": fields}


def type_hash(name):
    """RIHS01, computed here: what ours says is not asked."""
    whole = {"type_description": described(name), "referenced_type_descriptions": [described(part) for part in sorted(used_by(name))]}
    return "RIHS01_" + hashlib.sha256(json.dumps(whole, separators=(", ", ": ")).encode()).hexdigest()


def definition(name):
    """Its text with those of all that is in it: the SDK's own texts are on the network."""
    parts = [f"{'=' * 80}\nMSG: {part}\n{FIELDS[part]}" for part in sorted(used_by(name))]
    return "\n".join([FIELDS[name], *parts])


class ZenohBase(Motion):
    """`kind` and `kind_hash` are what it wants on cmd_vel where that is not what it should want."""

    def __init__(self, port, stamped, kind=None, kind_hash=None, cmd_vel="/robot/cmd_vel", odom="/robot/odom"):
        from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
        super().__init__(stamped)
        kind, where = kind or (STAMPED if stamped else TWIST), dict(node_name="base_control", domain_id=7, router_port=port)
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
