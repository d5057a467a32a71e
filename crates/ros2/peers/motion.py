"""How a SUMMIT-XL's controller drives: 50 Hz, first-order lag, limits, and rest after 0.25 s without an order. The ways to hear
orders and to tell odometry are the subclasses'."""
import math
import time

RATE_HZ, LAG_S, SPEED_MAX = 50.0, 0.05, 1.5


class Motion:
    def __init__(self, stamped):
        self.stamped, self.timeout_s = stamped, 0.25
        self.received = self.sent = self.timeouts = self.zeros = 0
        self.wanted, self.velocity, self.pose = [0.0] * 3, [0.0] * 3, [0.0] * 3
        self.ordered_at, self.moving_order = time.monotonic(), False
        self.frames, self.stamps, self.oldest_s = set(), [], 0.0

    def orders(self):
        """The orders since the last call, oldest first."""
        raise NotImplementedError

    def tell(self, ns, pose, velocity):
        """Sends odometry of this time."""
        raise NotImplementedError

    def tick(self, muted=False, late_by_s=0.0):
        now, dt = time.monotonic(), 1.0 / RATE_HZ
        for order in self.orders():
            twist = order.twist if self.stamped else order
            if self.stamped:
                self.frames.add(order.header.frame_id)
                self.stamps.append(order.header.stamp.sec)
                self.oldest_s = max(self.oldest_s, time.time() - order.header.stamp.sec - 1e-9 * order.header.stamp.nanosec)
            self.wanted = [twist.linear.x, twist.linear.y, twist.angular.z]
            self.received += 1
            self.zeros += self.wanted == [0.0] * 3
            self.ordered_at, self.moving_order = now, self.wanted != [0.0] * 3
        if now - self.ordered_at > self.timeout_s and self.moving_order:
            self.timeouts, self.moving_order, self.wanted = self.timeouts + 1, False, [0.0] * 3
        share = 1.0 - math.exp(-dt / LAG_S)
        for i, wanted in enumerate(self.wanted):
            self.velocity[i] += share * (max(-SPEED_MAX, min(SPEED_MAX, wanted)) - self.velocity[i])
        x, y, yaw = self.velocity
        cos, sin = math.cos(self.pose[2] + 0.5 * dt * yaw), math.sin(self.pose[2] + 0.5 * dt * yaw)
        self.pose = [self.pose[0] + dt * (cos * x - sin * y), self.pose[1] + dt * (sin * x + cos * y), self.pose[2] + dt * yaw]
        if not muted:
            self.tell(time.time_ns() - int(late_by_s * 1e9), self.pose, self.velocity)
            self.sent += 1

    def run(self, done, **how):
        """Drives until `done(seconds)`; `muted` and `late_by_s` are functions of the seconds since the start."""
        start = next_tick = time.monotonic()
        while not done(time.monotonic() - start):
            elapsed = time.monotonic() - start
            self.tick(**{name: value(elapsed) for name, value in how.items()})
            next_tick = max(next_tick + 1.0 / RATE_HZ, time.monotonic() - 0.5)
            time.sleep(max(0.0, next_tick - time.monotonic()))
