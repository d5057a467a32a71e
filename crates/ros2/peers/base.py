"""A base over DDS, by Cyclone."""
import math

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import messages as m
from motion import Motion

QOS = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10), Policy.Durability.Volatile)


class Base(Motion):
    def __init__(self, domain, stamped, cmd_vel="/cmd_vel", odom="/odom"):
        super().__init__(stamped)
        self.participant, self.order = DomainParticipant(domain), m.TwistStamped if stamped else m.Twist
        self.reader = DataReader(self.participant, Topic(self.participant, "rt" + cmd_vel, self.order, qos=QOS), qos=QOS)
        self.writer = DataWriter(self.participant, Topic(self.participant, "rt" + odom, m.Odometry, qos=QOS), qos=QOS)

    def orders(self):
        return [sample for sample in self.reader.take(N=100) if type(sample) is self.order]

    def tell(self, ns, pose, velocity):
        x, y, yaw = velocity
        half = pose[2] / 2
        self.writer.write(m.Odometry(
            m.Header(m.Time(ns // 10**9, ns % 10**9), "odom"), "base_link",
            m.PoseWithCovariance(m.Pose(m.Vector3(pose[0], pose[1], 0.0), m.Quaternion(0.0, 0.0, math.sin(half), math.cos(half)))),
            m.TwistWithCovariance(m.Twist(m.Vector3(x, y, 0.0), m.Vector3(0.0, 0.0, yaw)))))
