"""Watches a robot with libraries that are not ours: PyPI `websockets` and `rosbags` (pip install websockets rosbags).

usage: foreign_viewer.py ws://127.0.0.1:8765

Decodes every topic by the definition that the server sends and, where ROS 2 has the message, checks that definition against
ROS 2's own. Exits non-zero if a topic does not decode, a message of ROS 2 is not as ROS 2 defines it, one of the topics that
come by themselves does not come, the tree of frames does not lead to the flange that the daemon says, or a parameter can be
written.
"""

import asyncio
import json
import math
import struct
import sys
import time

import websockets
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

# What comes only when something happens, or only of a real robot.
RARE = {"/contact", "/link", "/log", "/target"}
# A loaded machine is slow; nothing is claimed about times.
PATIENCE_S = 60
# ROS 2's own definitions.
JAZZY = get_typestore(Stores.ROS2_JAZZY)


def typestore(schema_name, definition):
    """A reader that knows `definition` and nothing else."""
    root, *others = ("MSG: " + schema_name.replace("/msg/", "/") + "\n" + definition).split("=" * 80 + "\n")
    store = get_typestore(Stores.EMPTY)
    for part in [root, *others]:
        name, _, fields = part.removeprefix("MSG: ").partition("\n")
        store.register(get_types_from_msg(fields, name.strip().replace("/", "/msg/")))
    return store


def as_ros_has_it(schema_name, store):
    """Whether ROS 2 defines this message, and every one within it, with the same fields."""
    if schema_name not in JAZZY.fielddefs:
        assert schema_name.startswith("moca_msgs/"), schema_name
        return False
    for name, (_, fields) in store.fielddefs.items():
        theirs = [(field, kind) for field, kind in JAZZY.fielddefs[name][1]]
        assert fields == theirs, f"{name}: {fields} is not ROS 2's {theirs}"
    return True


def rotated(q, v):
    t = [2 * (q.y * v[2] - q.z * v[1]), 2 * (q.z * v[0] - q.x * v[2]), 2 * (q.x * v[1] - q.y * v[0])]
    return [
        v[0] + q.w * t[0] + q.y * t[2] - q.z * t[1],
        v[1] + q.w * t[1] + q.z * t[0] - q.x * t[2],
        v[2] + q.w * t[2] + q.x * t[1] - q.y * t[0],
    ]


def flange_by_frames(last):
    tree = {t.child_frame_id: t for topic in ("/tf", "/tf_static") for t in last[topic].transforms}
    point, frame = [0.0, 0.0, 0.0], "flange"
    while frame != "world":
        step = tree[frame].transform
        point = rotated(step.rotation, point)
        point = [point[0] + step.translation.x, point[1] + step.translation.y, point[2] + step.translation.z]
        frame = tree[frame].header.frame_id
    return point


async def main(address):
    channels, stores, counts, sizes, last, times, answers = {}, {}, {}, {}, {}, {}, {}
    async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        end = time.time() + PATIENCE_S
        began = end
        expected = lambda: {channel["topic"] for channel in channels.values()} - RARE
        while (not channels or expected() - counts.keys()) and time.time() < end:
            try:
                message = await asyncio.wait_for(socket.recv(), 1)
            except asyncio.TimeoutError:
                continue
            if isinstance(message, str):
                message = json.loads(message)
                if message["op"] == "advertise":
                    for channel in message["channels"]:
                        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
                        channels[channel["id"]] = channel
                        store = typestore(channel["schemaName"], channel["schema"])
                        stores[channel["id"]] = store
                        channel["ros"] = as_ros_has_it(channel["schemaName"], store)
                    began = time.time()
                    pairs = [{"id": 100 + id, "channelId": id} for id in channels]
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))
                    wish = {"name": "control.gains.reactivity", "value": 7.5}
                    await socket.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "before"}))
                    await socket.send(json.dumps({"op": "setParameters", "parameters": [wish], "id": "set"}))
                    await socket.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "after"}))
                elif message["op"] == "parameterValues":
                    answers[message["id"]] = message["parameters"]
                continue
            kind, subscription, stamp = struct.unpack_from("<BIQ", message)
            assert kind == 1
            channel = channels[subscription - 100]
            topic, name = channel["topic"], channel["schemaName"]
            last[topic] = stores[channel["id"]].deserialize_cdr(message[13:], name)
            assert stamp >= times.get(topic, 0), f"{topic} runs backwards"
            times[topic] = stamp
            counts[topic] = counts.get(topic, 0) + 1
            sizes[topic] = sizes.get(topic, 0) + len(message)
    seconds = time.time() - began
    assert channels, "no channel was offered: does the daemon run?"
    for channel in sorted(channels.values(), key=lambda channel: channel["topic"]):
        topic = channel["topic"]
        n = counts.get(topic, 0)
        assert n > 0 or topic in RARE, f"{topic} does not come"
        origin = "ROS 2's" if channel["ros"] else "ours"
        print(f"{topic:20} {channel['schemaName']:34} {origin:8} {n / seconds:7.1f} Hz {sizes.get(topic, 0) / max(n, 1):7.0f} bytes")
    flange = last["/flange"].pose.position
    error = math.dist(flange_by_frames(last), (flange.x, flange.y, flange.z))
    # The two may be of consecutive messages only if their stamps differ.
    same = last["/tf"].transforms[0].header.stamp == last["/flange"].header.stamp
    print(f"flange by /tf and /tf_static: {error:.1e} m from /flange, same instant: {same}")
    assert error < (1e-9 if same else 1e-2)
    assert answers["before"] and answers["after"] == answers["before"], "a parameter was written"
    print(f"{len(answers['before'])} parameters, none of them can be written")


asyncio.run(main(sys.argv[1]))
