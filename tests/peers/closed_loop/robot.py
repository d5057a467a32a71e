"""The robot as its URDF describes it (`mocad describe --urdf`), and the numbers that no URDF has."""

import pathlib
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

TAXELS = 11
HOME_RAD = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
CONTROL_PERIOD_S = 1e-3
# The base's servo: first order, limited in acceleration, on wheels that are stiff until they slip.
SERVO_TIME_CONSTANT_S = 0.015
ACCELERATION_MAX = np.array([3.0, 3.0, 6.0])
WHEEL_DAMPING = np.array([1e5, 1e5, 2.5e4])
TRACTION = np.array([1000.0, 1000.0, 400.0])


@dataclass(frozen=True)
class Robot:
    """The arm in Pinocchio on a base that stands still, and where it and the taxels are on the base."""

    urdf: pathlib.Path
    arm: pin.Model
    flange: int
    mount_m: Vector
    taxel_m: Matrix
    taxel_inward: Matrix

    @classmethod
    def read(cls, urdf: pathlib.Path) -> "Robot":
        arm = pin.buildModelFromUrdf(str(urdf))
        taxels = [_origin(urdf, f"taxel_{taxel + 1}_place") for taxel in range(TAXELS)]
        mount, rpy = _origin(urdf, "arm_mount")
        assert not rpy.any(), "the arm is mounted with a turn"
        inward = np.array([[np.cos(rpy[2]), np.sin(rpy[2])] for _, rpy in taxels])
        return cls(urdf, arm, arm.getFrameId("flange"), mount, np.array([place[:2] for place, _ in taxels]), inward)

    def cover_wrench(self, force_n: Vector) -> Vector:
        """f_x, f_y, m_z on the base in its axes from the force on each taxel, eq. (4)."""
        force = self.taxel_inward * force_n[:, None]
        x, y = self.taxel_m.T
        return np.array([force[:, 0].sum(), force[:, 1].sum(), (x * force[:, 1] - y * force[:, 0]).sum()])


def turn(yaw: float) -> Matrix:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def servo_step(servo: Vector, wanted: Vector) -> Vector:
    """What the wheels are asked for after one control period, axes of the base."""
    gain = 1 - np.exp(-CONTROL_PERIOD_S / SERVO_TIME_CONSTANT_S)
    most = ACCELERATION_MAX * CONTROL_PERIOD_S
    return servo + np.clip(gain * (wanted - servo), -most, most)


def wheel_force(servo_world: Vector, velocity_world: Vector) -> Vector:
    """Force of the wheels on the base beside their viscous part, −WHEEL_DAMPING · velocity_world."""
    held = WHEEL_DAMPING * velocity_world
    return np.clip(WHEEL_DAMPING * servo_world - held, -TRACTION, TRACTION) + held


def _origin(urdf: pathlib.Path, joint: str) -> tuple[Vector, Vector]:
    found = ElementTree.parse(urdf).find(f"joint[@name='{joint}']/origin")
    assert found is not None, f"{urdf} has no joint {joint}"
    place, rpy = (np.array([float(v) for v in found.attrib[key].split()]) for key in ("xyz", "rpy"))
    return place, rpy
