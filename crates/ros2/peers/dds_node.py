"""A node over DDS, by Cyclone."""
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import messages as m
from base import QOS

LATCHED = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(1), Policy.Durability.TransientLocal)


def kind_of(name):
    short = name.split("/")[-1]
    return getattr(m, {"String": "Text"}.get(short, short))


class DdsNode:
    def __init__(self, domain):
        self.participant, self.calls = DomainParticipant(domain), {}

    def made(self, name, *fields):
        """A message of that type."""
        return kind_of(name)(*fields)

    def reader(self, topic, name, latched=False):
        """What has come since it was asked last, oldest first, as a function."""
        qos, of = LATCHED if latched else QOS, kind_of(name)
        reader = DataReader(self.participant, Topic(self.participant, "rt" + topic, of, qos=qos), qos=qos)
        return lambda: [message for message in reader.take(N=200) if type(message) is of]

    def writer(self, topic, name):
        """A function that sends."""
        return DataWriter(self.participant, Topic(self.participant, "rt" + topic, kind_of(name), qos=QOS), qos=QOS).write

    def call(self, service):
        """Calls a trigger as Cyclone's ROS middleware does, and waits for its answer."""
        if service not in self.calls:
            asks = Topic(self.participant, f"rq{service}Request", m.TriggerCall, qos=QOS)
            hears = Topic(self.participant, f"rr{service}Reply", m.TriggerAnswer, qos=QOS)
            self.calls[service] = DataWriter(self.participant, asks, qos=QOS), DataReader(self.participant, hears, qos=QOS)
            time.sleep(2.0)
        asks, hears = self.calls[service]
        asks.write(m.TriggerCall(7, len(service), 0))
        for _ in range(500):
            for answer in hears.take(N=10):
                if type(answer) is m.TriggerAnswer and (answer.client, answer.number) == (7, len(service)):
                    return answer.success, answer.message
            time.sleep(0.01)
        raise AssertionError(f"no answer of {service}")
