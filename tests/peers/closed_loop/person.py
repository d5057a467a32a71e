"""A leg before T1 and the foam between: the numbers of the collision, and where the two meet."""

import math
from dataclasses import dataclass

import numpy as np

from .robot import Robot, Vector

TAXEL = 0
GAP_M = 0.25
RADIUS_M = 0.07
MASS_KG = 75.0
TISSUE_N_M = 5e4
POSTURE_N_M = 800.0
POSTURE_N_S_M = 300.0
FRICTION = 0.4
# Foam: F = F_e + T·dF_e/dt with F_e = k·x/(1 − x/h).
FOAM_N_M = 2105.0
FOAM_M = 0.015
FOAM_S = 0.005
SHEAR_SHARE = 0.4
# Away from the robot, 1.5 s after the first touch, 3 m at 1 m/s.
STEPS_AWAY_AFTER_S = 1.5
STEP_M_S = 1.0
STEP_M = 3.0


def foam_n(x_m: float) -> float:
    return FOAM_N_M * x_m / (1 - x_m / FOAM_M)


def foam_m(elastic_n: float) -> float:
    return elastic_n / (FOAM_N_M + elastic_n / FOAM_M)


@dataclass(frozen=True)
class Meeting:
    overlap_m: float
    sliding_m_s: float
    """Of the leg along the cover, its outward normal turned by +90°."""
    point_base: Vector
    cos: float
    sin: float

    def to_world(self, x: float, y: float) -> tuple[float, float]:
        return self.cos * x - self.sin * y, self.sin * x + self.cos * y


@dataclass(frozen=True)
class Person:
    start_m: Vector
    outward: Vector
    on_cover_m: Vector

    @classmethod
    def before(cls, robot: Robot) -> "Person":
        outward, place = -robot.taxel_inward[TAXEL], robot.taxel_m[TAXEL]
        return cls(place + outward * (RADIUS_M + GAP_M), outward, place)

    def meeting(self, base: Vector, base_velocity: Vector, moved: Vector, velocity: Vector) -> Meeting:
        """Base pose and velocity in the world, and how far and fast the leg is from its start."""
        cos, sin = math.cos(base[2]), math.sin(base[2])
        dx, dy = self.start_m[0] + moved[0] - base[0], self.start_m[1] + moved[1] - base[1]
        away_x, away_y = cos * dx + sin * dy - self.on_cover_m[0], -sin * dx + cos * dy - self.on_cover_m[1]
        nx, ny = self.outward
        along = -away_x * ny + away_y * nx
        point = self.on_cover_m + along * np.array([-ny, nx])
        vx, vy = velocity[0] - base_velocity[0], velocity[1] - base_velocity[1]
        slide_x, slide_y = cos * vx + sin * vy + base_velocity[2] * point[1], -sin * vx + cos * vy - base_velocity[2] * point[0]
        overlap = RADIUS_M - (away_x * nx + away_y * ny)
        assert overlap <= 0 or abs(along) < 0.08, f"the leg is {along} m from the middle of its taxel"
        return Meeting(overlap, slide_y * nx - slide_x * ny, point, cos, sin)

    def forces(self, met: Meeting, normal_n: float, along_n: float) -> tuple[Vector, Vector]:
        """On the base about its origin (world axes), and on the leg."""
        nx, ny = self.outward
        fx, fy = normal_n * nx - along_n * ny, normal_n * ny + along_n * nx
        on_leg = np.array(met.to_world(fx, fy))
        px, py = met.point_base
        return np.r_[-on_leg, -(px * fy - py * fx)], on_leg


def posture_n(moved: Vector, velocity: Vector, away: Vector | None, stepping_s: float) -> Vector:
    """What holds the leg where it wants to be; `away` is known after the first touch."""
    stride = min(max(STEP_M_S * stepping_s, 0.0), STEP_M)
    walks = STEP_M_S if 0.0 < stride < STEP_M else 0.0
    direction = np.zeros(2) if away is None else away
    return POSTURE_N_M * (stride * direction - moved) + POSTURE_N_S_M * (walks * direction - velocity)
