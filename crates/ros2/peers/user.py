"""What a user's nodes do with the robot behind its bridge, over whatever link a node has."""
import json
import math
import os
import signal
import subprocess
import time

STRING, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"
POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
TWIST, STAMPED, VECTOR = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Vector3"
GRIPPER, FINGERS = "control_msgs/msg/GripperCommand", "/moca/gripper/joint_states"
HEADER, TIME, PLACE = "std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Pose"
SHOWN = {
    "/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage", "/joint_states": "sensor_msgs/msg/JointState",
    "/moca/cover_wrench": WRENCH, "/moca/flange_wrench": WRENCH, "/moca/flange": POSE,
    "/moca/taxels": "std_msgs/msg/Float64MultiArray", "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
HELD = {FINGERS: "sensor_msgs/msg/JointState", "/moca/gripper/state": "diagnostic_msgs/msg/DiagnosticStatus"}


class User:
    """Hears `topics`, and leads the robot."""

    def __init__(self, node, topics):
        self.node = node
        self.readers = {topic: node.reader(topic, name) for topic, name in topics.items()}
        told = {"target_pose": POSE, "target_twist": STAMPED, "cmd_vel": TWIST, "cmd_vel_stamped": STAMPED, "alive": EMPTY,
                "gripper/command": GRIPPER}
        self.writers = {topic: node.writer("/moca/" + topic, name) for topic, name in told.items()}
        self.refusals, self.counts, self.last, self.base, self.yaw = [], {}, {}, None, 0.0

    def call(self, service):
        answer = self.node.call("/moca/" + service)
        print(f"  {service}: {answer}", flush=True)
        return answer

    def hear(self, seconds=0.05):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for topic, take in self.readers.items():
                for message in take():
                    self.counts[topic], self.last[topic] = self.counts.get(topic, 0) + 1, message
                    if topic == "/moca/target_refused":
                        self.refusals.append(message.data)
                    if topic == "/tf":
                        for frame in message.transforms:
                            if frame.child_frame_id == "base_link":
                                self.base, turn = frame.transform.translation, frame.transform.rotation
                                self.yaw = 2.0 * math.atan2(turn.z, turn.w)
            time.sleep(0.005)

    def flange(self):
        position = self.last["/moca/flange"].pose.position
        return [position.x, position.y, position.z]

    def flange_y(self):
        """The y axis of the flange, in the world."""
        turn = self.last["/moca/flange"].pose.orientation
        x, y, z, w = turn.x, turn.y, turn.z, turn.w
        return [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)]

    def robot(self):
        return self.last["/diagnostics"].status[0]

    def mode(self):
        return {value.key: value.value for value in self.robot().values}["mode"]

    def vector(self, x=0.0, y=0.0, z=0.0):
        return self.node.made(VECTOR, x, y, z)

    def header(self, frame, ns=0):
        return self.node.made(HEADER, self.node.made(TIME, ns // 10**9, ns % 10**9), frame)

    def twist(self, vy, frame="world", ago_s=0.0):
        twist = self.node.made(TWIST, self.vector(y=vy), self.vector())
        self.writers["target_twist"](self.node.made(STAMPED, self.header(frame, time.time_ns() - int(ago_s * 1e9)), twist))

    def pose(self, position):
        pose = self.last["/moca/flange"].pose
        place = self.node.made(PLACE, type(pose.position)(*position), pose.orientation)
        self.writers["target_pose"](self.node.made(POSE, self.header("world"), place))

    def drive(self, vx, vz=0.0, turn=0.0):
        self.writers["cmd_vel"](self.node.made(TWIST, self.vector(vx, 0.0, vz), self.vector(z=turn)))

    def drive_stamped(self, vx, ago_s=0.0):
        twist = self.node.made(TWIST, self.vector(vx), self.vector())
        self.writers["cmd_vel_stamped"](
            self.node.made(STAMPED, self.header("base_link", time.time_ns() - int(ago_s * 1e9)), twist))

    def live(self):
        self.writers["alive"](self.node.made(EMPTY, 0))

    def close_to(self, width_m, force_n=0.0):
        self.writers["gripper/command"](self.node.made(GRIPPER, 0.5 * width_m, force_n))

    def gripper(self):
        """Its values, by name, and the fingers' distance."""
        values = {value.key: value.value for value in self.last["/moca/gripper/state"].values}
        return values, sum(self.last[FINGERS].position)

    def led_along(self, frame, axis):
        """Leads the flange 20 mm along y of a frame, which is `axis` in the world."""
        start, way = self.flange(), [0.0] * 3

        def far():
            way[:] = [a - b for a, b in zip(self.flange(), start)]
            return math.hypot(*way) > 0.02
        self.until(far, lambda: self.twist(0.03, frame), f"led along y of {frame}")
        along = sum(a * b for a, b in zip(way, axis)) / math.hypot(*way)
        print(f"  y of {frame}: {[round(x, 2) for x in axis]}, led by {[round(x, 4) for x in way]}", flush=True)
        assert along > 0.97, along

    def until(self, done, ask, what):
        for _ in range(400):
            ask()
            self.hear()
            if done():
                return
        raise AssertionError(f"never {what}: {self.refusals[-3:]} {self.last.get('/diagnostics')}")

    def refused(self, ask, said):
        self.refusals.clear()
        self.until(lambda: any(said in why for why in self.refusals), ask, f"refused as {said!r}")
        print("  refused:", next(why for why in self.refusals if said in why), flush=True)


def talk(node):
    """Topics out, services in, and the dead-man's rule."""
    user = User(node, SHOWN)
    user.hear(8)
    urdf = node.reader("/robot_description", STRING, latched=True)
    assert user.call("tare")[0]
    # It is answered when it begins.
    user.until(lambda: user.call("arm")[0], lambda: None, "armed after the tare")
    user.hear(1.5)
    assert user.mode() == "impedance"
    assert user.call("stop")[0]
    user.hear(1.5)
    assert user.mode() == "protective stop" and user.robot().level == 2
    assert user.call("resume")[0] and user.call("arm")[0]
    for _ in range(12):
        user.live()
        user.hear(0.5)
    print("  signs of life alone:", user.mode(), user.robot().message)
    assert user.mode() == "impedance", "a sign of life is enough"
    user.hear(6)
    print("  nobody shows life:", user.mode(), user.robot().message)
    assert user.mode() == "protective stop", "whoever armed and is not heard from has gone"
    descriptions = urdf()
    print("  received", user.counts, "robot_description", [len(text.data) for text in descriptions], flush=True)
    assert set(user.counts) == set(SHOWN), set(SHOWN) - set(user.counts)
    assert len(user.last["/joint_states"].name) == len(user.last["/joint_states"].position) == 7
    assert len(user.last["/moca/taxels"].data) == 33 and user.last["/moca/taxels"].data[1] == 1.0
    assert descriptions and descriptions[0].data.startswith("<?xml"), "who comes later gets the description too"
    return user


def lead(node, peer, daemon):
    """Flange and base led by nodes: one of them at a time, under the daemon's own rule of who commands. `peer(what)` is another
    process of the same link that listens, or pushes once it is told to, `daemon(*words)` one that asks the daemon without ROS."""
    user = User(node, SHOWN | {"/moca/target_refused": STRING})
    user.hear(8)
    frozen, other = peer("listen"), peer("push")
    user.refused(lambda: user.twist(0.03), "not possible in mode ready")
    assert user.call("arm")[0] and user.call("end_target")[0]
    start = user.flange()
    user.until(lambda: user.flange()[1] > start[1] + 0.02, lambda: user.twist(0.03), "led along y")
    user.until(lambda: user.mode() == "follow-me", lambda: user.twist(0.0), "in follow-me")
    wanted = [start[0], start[1], start[2] + 0.03]
    near = lambda: max(abs(a - b) for a, b in zip(user.flange(), wanted)) < 6e-3
    user.until(near, lambda: user.pose(wanted), "at the pose")
    x = user.base.x
    user.until(lambda: user.base.x > x + 0.05, lambda: user.drive(0.1), "driven")

    x = user.base.x
    user.until(lambda: user.base.x > x + 0.05, lambda: user.drive_stamped(0.1), "driven by stamped velocities")
    user.refused(lambda: user.drive_stamped(0.1, ago_s=5.0), "age of the target")
    user.until(lambda: user.yaw > 0.3, lambda: user.drive(0.0, turn=0.3), "turned")
    # Let it come to rest: what is led next is measured.
    for _ in range(20):
        user.twist(0.0)
        user.hear()
    user.led_along("base_link", [-math.sin(user.yaw), math.cos(user.yaw), 0.0])
    user.led_along("flange", user.flange_y())
    user.led_along("world", [0.0, 1.0, 0.0])
    wanted = user.flange()
    wanted[2] += 0.1
    for _ in range(5):
        user.pose(wanted)
        user.hear()
    assert user.call("end_target")[0]
    target = json.loads(daemon("status", "--json", stdout=subprocess.PIPE).communicate()[0])["target"]
    print("  target:", target, flush=True)
    assert (target["kind"], target["phase"]) == ("pose", "ended"), "by the request, not by its age"
    user.until(lambda: user.mode() == "follow-me", lambda: user.twist(0.0), "still leading")

    other.stdin.write(b"now\n")
    other.stdin.flush()
    user.refused(lambda: user.twist(0.0), "target_twist: another node leads")
    # The other is refused, not this one, whichever of its topics it leads on.
    user.refused(lambda: user.twist(0.03, frame="map"), 'frame_id "map": allowed: "world", "base_link", "flange"')
    user.refused(lambda: user.drive(0.1, vz=0.1), "linear.z = 0.1: allowed: 0, a base moves in the plane")
    other.kill()
    other.wait(60)
    user.refused(lambda: user.twist(0.5), "linear speed y = 0.5")
    user.refused(lambda: user.twist(float("nan")), "not a finite number")
    user.refused(lambda: user.twist(0.03, ago_s=5.0), "age of the target")
    user.refused(lambda: user.pose([5.0, 0.0, 1.0]), "distance from the arm's shoulder")

    # A subscriber that has frozen is waited for by nobody.
    os.kill(frozen.pid, signal.SIGSTOP)
    user.counts.clear()
    for _ in range(60):
        user.twist(0.0)
        user.hear()
    os.kill(frozen.pid, signal.SIGCONT)
    frozen.kill()
    frozen.wait(60)
    print("  beside a frozen subscriber:", user.counts, flush=True)
    assert min(user.counts[topic] for topic in ("/moca/flange", "/tf", "/joint_states")) > 60
    assert user.mode() == "follow-me", user.last["/diagnostics"]

    assert user.call("disarm")[0]
    user.until(lambda: user.mode() == "ready", lambda: None, "disarmed")
    holds = daemon("arm", stdout=subprocess.DEVNULL)
    user.until(lambda: user.mode() == "follow-me", lambda: None, "armed by somebody else")
    user.refused(lambda: user.twist(0.03), "another client has the command")
    holds.send_signal(signal.SIGINT)
    holds.wait(60)
    assert user.call("arm")[0]
    user.until(lambda: user.mode() == "follow-me", lambda: user.twist(0.0), "armed again")
    # The node dies between two targets.
    user.until(lambda: user.mode() == "protective stop", lambda: None, "stopped when nobody leads it any more")


def grasp(node, daemon):
    """The gripper of a robot that armed itself and goes on by itself: it is never stopped for a node that asked the fingers."""
    user = User(node, SHOWN | HELD | {"/moca/target_refused": STRING})
    user.hear(8)
    last, width_m = user.gripper()
    assert (last["phase"], last["holds"], last["fault"]) == ("resting", "false", ""), last
    assert list(user.last[FINGERS].name) == ["finger_joint1", "finger_joint2"] and abs(width_m - 0.08) < 1e-6, width_m

    def ends(phase, width_m, asked):
        user.hear(1.0)
        asked()
        rests = lambda: user.gripper()[0]["phase"] == phase and abs(user.gripper()[1] - width_m) < 1e-6
        user.until(rests, lambda: None, f"{phase} at {width_m} m")
        print(f"  {phase} at {width_m} m:", user.gripper()[0], flush=True)

    velocities = []

    def moves():
        user.close_to(0.06)
        user.until(lambda: velocities.extend(user.last[FINGERS].velocity) or user.gripper()[1] < 0.0601, lambda: None, "closing")
    ends("resting", 0.06, moves)
    assert min(velocities) < -0.02 and abs(min(velocities) + 0.025) < 2e-3, min(velocities)
    ends("holding", 0.05, lambda: user.close_to(0.05, 40.0))
    assert user.gripper()[0]["holds"] == "true" and user.gripper()[0]["object, kg"] == "0"
    user.refused(lambda: user.close_to(0.09), "gripper/command: width of the gripper = 0.09 m; allowed: 0 to 0.08 m")
    user.refused(lambda: user.close_to(0.05, float("nan")), "force of the gripper = NaN N; allowed: 1 to 70 N")
    assert user.gripper()[0]["holds"] == "true", "a refused request changes nothing"
    assert user.call("gripper/stop")[0]
    user.hear(0.5)
    assert user.gripper()[0]["holds"] == "true", "nor does a stop of the fingers let go"
    # Nobody has shown life for longer than a commander may be silent, and the command is free.
    user.hear(5)
    assert user.mode() == "follow-me", user.robot()
    assert daemon("gripper", "move", "0.07").wait(60) == 0, "the command was given back"
    ends("resting", 0.08, lambda: user.call("gripper/release"))
    ends("resting", 0.05, lambda: user.close_to(0.02))
    state = user.last["/moca/gripper/state"]
    assert (state.level, user.gripper()[0]["fault"]) == (1, "fingers-blocked") and "Take away" in state.message, state
    ends("resting", 0.08, lambda: user.call("gripper/release"))
    # The cube stands between the fingers.
    ends("resting", 0.05, lambda: user.call("gripper/home"))

    # Whoever leads keeps the command, and loses it like anybody.
    for step in range(40):
        user.twist(0.0)
        if step == 20:
            user.close_to(0.07)
        user.hear()
    assert daemon("gripper", "move", "0.06", stderr=subprocess.DEVNULL).wait(60) != 0, "a node leads"
    user.until(lambda: user.mode() == "protective stop", lambda: None, "stopped when nobody leads it any more")


def listen(node):
    take = node.reader("/joint_states", SHOWN["/joint_states"])
    while not take():
        time.sleep(0.01)
    print("begun", flush=True)
    while True:
        take()
        time.sleep(0.01)


def push(node):
    user = User(node, {})
    print("begun", flush=True)
    input()
    while True:
        user.twist(0.03)
        time.sleep(0.02)
