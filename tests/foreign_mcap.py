"""Reads a log with libraries that are not ours: PyPI `mcap` and `mcap-ros2-support` (pip install mcap mcap-ros2-support).

usage: foreign_mcap.py FILE

Prints the messages of each channel and the range of their times; exits non-zero if the file is not a valid MCAP, a
message in JSON misses a field that its schema requires, one of ROS 2 does not decode by its schema, a channel's times run
backwards, or the robot's URDF is not among the attachments.
"""

import json
import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

with open(sys.argv[1], "rb") as stream:
    counts, last, ros2 = {}, {}, DecoderFactory()
    for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
        if schema is None:
            assert channel.message_encoding == "application/octet-stream", channel.topic
        elif channel.message_encoding == "cdr":
            assert schema.encoding == "ros2msg", channel.topic
            ros2.decoder_for("cdr", schema)(message.data)
        else:
            assert schema.encoding == "jsonschema" and channel.message_encoding == "json", channel.topic
            body = json.loads(message.data)
            missing = set(json.loads(schema.data).get("required", [])) - set(body)
            assert not missing, f"{channel.topic} misses {missing}"
        assert message.log_time >= last.get(channel.topic, 0), f"{channel.topic} runs backwards"
        last[channel.topic] = message.log_time
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
    stream.seek(0)
    statistics = make_reader(stream).get_summary().statistics
    assert statistics.message_count == sum(counts.values()), "the summary counts other messages"

    stream.seek(0)
    names = [attachment.name for attachment in make_reader(stream).iter_attachments()]
    assert "robot.urdf" in names, names

for topic in ["/tf", "/tf_static", "/joint_states", "/scene/robot", "/scene/touch", "/robot_description", "/log"]:
    assert topic in counts, f"{topic} is missing"
for topic in sorted(counts):
    print(f"{topic:20} {counts[topic]:8} messages, last at {last[topic] * 1e-9:.3f} s")
