"""Reads a log with a library that is not ours: PyPI `mcap` (pip install mcap).

usage: foreign_mcap.py FILE

Prints the messages of each channel and the range of their times; exits non-zero if the file is not a valid MCAP, a
message with a schema is not JSON, misses a field that its schema requires, or a channel's times run backwards.
"""

import json
import sys

from mcap.reader import make_reader

with open(sys.argv[1], "rb") as stream:
    counts, last = {}, {}
    for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
        if schema is None:
            assert channel.message_encoding == "application/octet-stream", channel.topic
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

for topic in sorted(counts):
    print(f"{topic:10} {counts[topic]:8} messages, last at {last[topic] * 1e-9:.3f} s")
