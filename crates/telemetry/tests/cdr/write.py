"""Writes the messages beside this file with rosbags, an implementation of CDR that is not ours.

    pip install rosbags && python write.py
"""
import pathlib
import numpy as np
from rosbags.typesys import Stores, get_typestore, get_types_from_msg

store = get_typestore(Stores.ROS2_JAZZY)
SRV = "std_srvs/msg/"  # the layout is that of srv
store.register(get_types_from_msg("uint8 structure_needs_at_least_one_member", SRV + "Trigger_Request"))
store.register(get_types_from_msg("bool success\nstring message", SRV + "Trigger_Response"))
store.register(get_types_from_msg("float64 position\nfloat64 max_effort", "control_msgs/msg/GripperCommand"))
T = store.types


def make(name, *fields):
    return T[name](*fields)


def geometry(name, *fields):
    return make("geometry_msgs/msg/" + name, *fields)


def header(frame):
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", 1_700_000_000, 123_456_789), frame)


def numbers(*values):
    return np.array(values, dtype=np.float64)


point = geometry("Point", 1.5, -2.25, 0.125)
twist = geometry("Twist", geometry("Vector3", 0.1, -0.2, 0.3), geometry("Vector3", -0.4, 0.5, -0.6))
turn = geometry("Quaternion", 0.0, 0.0, 0.6, 0.8)
pose = geometry("Pose", point, turn)
wrench = geometry("Wrench", geometry("Vector3", 1.0, 2.0, 3.0), geometry("Vector3", 4.0, 5.0, 6.0))
cov = np.arange(36, dtype=np.float64)
transform = geometry("Transform", geometry("Vector3", 7.0, 8.0, 9.0), turn)
value = make("diagnostic_msgs/msg/KeyValue", "overruns", "3")
status = make("diagnostic_msgs/msg/DiagnosticStatus", 2, "mocad: loop", "stopped", "", [value, value])
dim = make("std_msgs/msg/MultiArrayDimension", "taxel", 2, 6)
MESSAGES = {
    "Twist": twist,
    "TwistStamped": geometry("TwistStamped", header("base_link"), twist),
    "PoseStamped": geometry("PoseStamped", header("odom"), pose),
    "WrenchStamped": geometry("WrenchStamped", header("flange"), wrench),
    "Odometry": make("nav_msgs/msg/Odometry", header("odom"), "base_footprint",
                     geometry("PoseWithCovariance", pose, cov), geometry("TwistWithCovariance", twist, cov)),
    "JointState": make("sensor_msgs/msg/JointState", header(""), ["a", "joint_2"], numbers(0.25, -0.5), numbers(1.0, 2.0),
                       numbers()),
    "TFMessage": make("tf2_msgs/msg/TFMessage",
                      [geometry("TransformStamped", header("odom"), name, transform) for name in ("base_link", "f")]),
    "DiagnosticArray": make("diagnostic_msgs/msg/DiagnosticArray", header(""), [status]),
    "Float64MultiArray": make("std_msgs/msg/Float64MultiArray", make("std_msgs/msg/MultiArrayLayout", [dim], 0),
                              numbers(1.0, 2.0, 3.0)),
    "Float64": make("std_msgs/msg/Float64", 0.2),
    "GripperCommand": make("control_msgs/msg/GripperCommand", 0.025, 40.0),
    "String": make("std_msgs/msg/String", "ein Gruß"),
    "Trigger_Request": make(SRV + "Trigger_Request", 0),
    "Trigger_Response": make(SRV + "Trigger_Response", True, "ready"),
}
folder = pathlib.Path(__file__).parent
with open(folder / "messages.txt", "w") as out:
    print("# name, byte order, payload: written by write.py", file=out)
    for name, message in MESSAGES.items():
        for order, little in (("little", True), ("big", False)):
            data = bytes(store.serialize_cdr(message, message.__msgtype__, little_endian=little))
            print(name, order, data.hex(), file=out)
