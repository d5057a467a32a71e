"""A base that drives as a SUMMIT-XL's controller does: 50 Hz, first-order lag, limits, and rest after 0.25 s without an
order."""
import math
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import messages as m

RATE_HZ, LAG_S, TIMEOUT_S, SPEED_MAX = 50.0, 0.05, 0.25, 1.5
QOS = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10), Policy.Durability.Volatile)


def now_stamp():
    ns = time.time_ns()
    return m.Time(ns // 10**9, ns % 10**9)


class Base:
    def __init__(self, domain, stamped, cmd_vel="/cmd_vel", odom="/odom"):
        self.participant, self.stamped = DomainParticipant(domain), stamped
        self.order = m.TwistStamped if stamped else m.Twist
        self.reader = DataReader(self.participant, Topic(self.participant, "rt" + cmd_vel, self.order, qos=QOS), qos=QOS)
        self.writer = DataWriter(self.participant, Topic(self.participant, "rt" + odom, m.Odometry, qos=QOS), qos=QOS)
        self.received = self.sent = self.timeouts = self.zeros = 0
        self.wanted, self.velocity, self.pose = [0.0] * 3, [0.0] * 3, [0.0] * 3
        self.ordered_at, self.moving_order = time.monotonic(), False
        self.frames, self.stamps = set(), []

    def tick(self, muted=False, late_by_s=0.0):
        now, dt = time.monotonic(), 1.0 / RATE_HZ
        for sample in self.reader.take(N=100):
            if type(sample) is not self.order:
                continue
            twist = sample.twist if self.stamped else sample
            if self.stamped:
                self.frames.add(sample.header.frame_id)
                self.stamps.append(sample.header.stamp.sec)
            self.wanted = [twist.linear.x, twist.linear.y, twist.angular.z]
            self.received += 1
            self.zeros += self.wanted == [0.0] * 3
            self.ordered_at, self.moving_order = now, self.wanted != [0.0] * 3
        if now - self.ordered_at > TIMEOUT_S and self.moving_order:
            self.timeouts, self.moving_order, self.wanted = self.timeouts + 1, False, [0.0] * 3
        share = 1.0 - math.exp(-dt / LAG_S)
        for i, wanted in enumerate(self.wanted):
            self.velocity[i] += share * (max(-SPEED_MAX, min(SPEED_MAX, wanted)) - self.velocity[i])
        x, y, yaw = self.velocity
        cos, sin = math.cos(self.pose[2] + 0.5 * dt * yaw), math.sin(self.pose[2] + 0.5 * dt * yaw)
        self.pose = [self.pose[0] + dt * (cos * x - sin * y), self.pose[1] + dt * (sin * x + cos * y), self.pose[2] + dt * yaw]
        if not muted:
            ns = time.time_ns() - int(late_by_s * 1e9)
            half = self.pose[2] / 2
            self.writer.write(m.Odometry(
                m.Header(m.Time(ns // 10**9, ns % 10**9), "odom"), "base_link",
                m.PoseWithCovariance(m.Pose(m.Vector3(self.pose[0], self.pose[1], 0.0),
                                            m.Quaternion(0.0, 0.0, math.sin(half), math.cos(half)))),
                m.TwistWithCovariance(m.Twist(m.Vector3(x, y, 0.0), m.Vector3(0.0, 0.0, yaw)))))
            self.sent += 1

    def run(self, done, **how):
        """Drives until `done(seconds)`; `muted` and `late_by_s` are functions of the seconds since the start."""
        start = next_tick = time.monotonic()
        while not done(time.monotonic() - start):
            elapsed = time.monotonic() - start
            self.tick(**{name: value(elapsed) for name, value in how.items()})
            next_tick = max(next_tick + 1.0 / RATE_HZ, time.monotonic() - 0.5)
            time.sleep(max(0.0, next_tick - time.monotonic()))
