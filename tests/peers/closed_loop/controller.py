"""The paper's two laws as they are printed, with explicit inverses: slow, and without a line of the project's."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from .robot import CONTROL_PERIOD_S, HOME_RAD, Matrix, Robot, Vector, turn

VIRTUAL_MASS = np.array([4.0, 4.0, 2.0])
VIRTUAL_DAMPING = np.array([80.0, 80.0, 60.0])
STIFFNESS = np.array([800.0, 800.0, 800.0, 40.0, 40.0, 40.0])
DAMPING_RATIO = 0.9
WEIGHT = np.diag([3.0] * 3 + [1.0] * 7)  # H of eq. (9)
POSTURE_STIFFNESS = np.array([90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0])
POSTURE_DAMPING = np.array([10.0, 10.0, 10.0, 10.0, 5.0, 3.5, 1.7])
BASE_VELOCITY_MAX = np.array([0.5, 0.5, 0.8])
BASE_ACCELERATION_MAX = np.array([3.0, 3.0, 6.0])
TORQUE_RATE_MAX = 1000.0


@dataclass(frozen=True)
class Command:
    base_velocity_body: Vector
    arm_torque_nm: Vector


@dataclass(frozen=True)
class Kinematics:
    """Of one tick, world axes."""

    yaw: Matrix
    flange: Vector
    rotation: Matrix
    jacobian: Matrix
    mass: Matrix
    bias: Vector
    arm_from_base: Vector
    flange_from_arm: Vector


@dataclass
class Controller:
    """`follow_me` chooses between eqs. (6)–(11) and (12)–(16). The target is in the world, or on the base."""

    robot: Robot
    follow_me: bool
    target_m: Vector | None = None
    target_rotation: Matrix | None = None
    target_velocity: Vector = field(default_factory=lambda: np.zeros(6))
    desired_velocity_body: Vector = field(default_factory=lambda: np.zeros(3))
    torque_nm: Vector | None = None

    def __post_init__(self) -> None:
        self._data = self.robot.arm.createData()

    def kinematics(self, q: Vector, v: Vector) -> Kinematics:
        arm, data, yaw = self.robot.arm, self._data, turn(q[2])
        pin.computeJointJacobians(arm, data, q[3:])
        pin.updateFramePlacements(arm, data)
        at = data.oMf[self.robot.flange]
        of_arm = pin.getFrameJacobian(arm, data, self.robot.flange, pin.LOCAL_WORLD_ALIGNED)
        upper = np.triu(pin.crba(arm, data, q[3:]))
        lever = yaw @ at.translation
        jacobian = np.zeros((6, 10))
        jacobian[0, 0] = jacobian[1, 1] = jacobian[5, 2] = 1.0
        jacobian[:2, 2] = -lever[1], lever[0]
        jacobian[:3, 3:], jacobian[3:, 3:] = yaw @ of_arm[:3], yaw @ of_arm[3:]
        return Kinematics(
            yaw=yaw,
            flange=lever + np.array([q[0], q[1], 0.0]),
            rotation=yaw @ at.rotation,
            jacobian=jacobian,
            mass=upper + np.triu(upper, 1).T,
            bias=pin.nonLinearEffects(arm, data, q[3:], v[3:]),
            arm_from_base=yaw @ self.robot.mount_m,
            flange_from_arm=lever - yaw @ self.robot.mount_m,
        )

    def step(self, q: Vector, v: Vector, taxel_n: Vector, flange_wrench: Vector) -> tuple[Command, Vector, Vector]:
        """The command, where the flange is and where it is wanted, m, world axes."""
        now = self.kinematics(q, v)
        base = np.array([q[0], q[1], 0.0])
        if self.target_m is None:
            self.target_m = now.yaw.T @ (now.flange - base) if self.follow_me else now.flange.copy()
            self.target_rotation = now.yaw.T @ now.rotation if self.follow_me else now.rotation.copy()
        self.target_m = self.target_m + CONTROL_PERIOD_S * self.target_velocity[:3]
        wanted_m = now.yaw @ self.target_m + base if self.follow_me else self.target_m
        wanted = now.yaw @ self.target_rotation if self.follow_me else self.target_rotation
        error = np.r_[wanted_m - now.flange, now.rotation @ pin.log3(now.rotation.T @ wanted)]
        posture = POSTURE_STIFFNESS * (HOME_RAD - q[3:]) - POSTURE_DAMPING * v[3:]
        cover = now.yaw @ self.robot.cover_wrench(taxel_n)
        law = self._follow_me if self.follow_me else self._impedance
        force, torque = law(now, v, error, posture, cover, flange_wrench)
        refused = self._admit(now, force)
        torque = torque + now.bias
        if not self.follow_me:
            torque = torque + _instead(now, refused)
        before = now.bias if self.torque_nm is None else self.torque_nm
        most = TORQUE_RATE_MAX * CONTROL_PERIOD_S
        change = torque - before
        self.torque_nm = before + change * min(1.0, most / max(np.abs(change).max(), most))
        return Command(self.desired_velocity_body, self.torque_nm), now.flange, wanted_m

    def _impedance(
        self, now: Kinematics, v: Vector, error: Vector, posture: Vector, cover: Vector, _flange: Vector
    ) -> tuple[Vector, Vector]:
        jacobian, mass = now.jacobian, np.zeros((10, 10))
        mass[:3, :3], mass[3:, 3:] = np.diag(VIRTUAL_MASS), now.mass
        inverse = np.linalg.inv(mass)
        mobility = jacobian @ inverse @ jacobian.T
        wrench = STIFFNESS * error + _damping(mobility) @ (self.target_velocity - jacobian @ v)
        null = np.r_[cover, posture]
        weight = np.linalg.inv(WEIGHT.T @ inverse @ WEIGHT)
        inner = np.linalg.inv(jacobian @ inverse @ weight @ inverse @ jacobian.T)
        spread = weight @ inverse @ jacobian.T @ inner
        whole = spread @ mobility @ wrench + null - spread @ jacobian @ inverse @ null
        return whole[:3], whole[3:]

    def _follow_me(
        self, now: Kinematics, v: Vector, error: Vector, posture: Vector, cover: Vector, flange: Vector
    ) -> tuple[Vector, Vector]:
        jacobian, inverse = now.jacobian[:, 3:], np.linalg.inv(now.mass)
        mobility = jacobian @ inverse @ jacobian.T
        wrench = STIFFNESS * error - _damping(mobility) @ jacobian @ v[3:]
        projected = jacobian.T @ np.linalg.inv(mobility) @ jacobian @ inverse @ posture
        moment = flange[3:] + np.cross(now.arm_from_base + now.flange_from_arm, flange[:3])
        led = np.array([flange[0], flange[1], moment[2]])
        return cover + led, jacobian.T @ wrench + posture - projected

    def _admit(self, now: Kinematics, force: Vector) -> Vector:
        """Eq. (2), exactly for a force that is held; the acceleration that the base's limits refuse, world axes."""
        decay = np.exp(-VIRTUAL_DAMPING / VIRTUAL_MASS * CONTROL_PERIOD_S)
        world = decay * (now.yaw @ self.desired_velocity_body) + (1 - decay) * force / VIRTUAL_DAMPING
        wanted = now.yaw.T @ world
        inside = np.clip(wanted, -BASE_VELOCITY_MAX, BASE_VELOCITY_MAX)
        most = BASE_ACCELERATION_MAX * CONTROL_PERIOD_S
        given = np.clip(inside, self.desired_velocity_body - most, self.desired_velocity_body + most)
        self.desired_velocity_body = given
        # Eq. (6) counts on the acceleration at the step's start; the velocity changes by its mean.
        start = VIRTUAL_DAMPING / VIRTUAL_MASS / (1 - decay)
        return start * (now.yaw @ (wanted - given))


def _instead(now: Kinematics, refused: Vector) -> Vector:
    """Joint torques that give the flange what the base does not: Λ_A J_B a."""
    jacobian = now.jacobian[:, 3:]
    mobility = jacobian @ np.linalg.inv(now.mass) @ jacobian.T
    return jacobian.T @ np.linalg.inv(mobility) @ now.jacobian[:, :3] @ refused


def _damping(mobility: Matrix) -> Matrix:
    """D_d of eq. (10) from Λ⁻¹."""
    values, vectors = np.linalg.eigh(mobility)
    root = DAMPING_RATIO * (vectors / np.sqrt(values)) @ vectors.T
    stiffness = np.diag(np.sqrt(STIFFNESS))
    return root @ stiffness + stiffness @ root
