"""Push, B2-i and the collision, run on any plant, tick by tick as the project's loop does."""

from dataclasses import dataclass, field
from typing import Callable, Protocol

import numpy as np

from .controller import Controller
from .person import TAXEL
from .robot import CONTROL_PERIOD_S, TAXELS, Robot, Vector

PUSH_S, RAMP_S, REST_S = 3.0, 0.3, 2.0
COLLISION_S = 5.0
TARGET_M_S = 0.2
SENSOR_TICKS = 10
# Ticks before the first row: the daemon's start and its sensor's phase.
SETTLING_TICKS = 20


class Plant(Protocol):
    """Base, arm, and whoever is met."""

    def state(self) -> tuple[Vector, Vector]:
        """x, y, yaw and seven joint angles, and their rates; world axes."""

    def person_n(self) -> float:
        """Force of the leg on its taxel now."""

    def begin(self) -> None:
        """The person's time begins."""

    def advance(self, wanted_body: Vector, torque_nm: Vector, taxel_n: Vector, flange_wrench: Vector) -> None:
        """One control period; hands press the taxels and pull at the flange."""


@dataclass
class Trace:
    """A row each tick: t, base pose, flange, and the force on the touched taxel."""

    rows: list[Vector] = field(default_factory=list)
    errors_m: list[float] = field(default_factory=list)

    @property
    def peak_n(self) -> float:
        return max(float(row[-1]) for row in self.rows)

    @property
    def flange_rms_mm(self) -> float:
        return 1e3 * float(np.sqrt(np.mean(np.square(self.errors_m))))


@dataclass(frozen=True)
class Experiment:
    name: str
    follow_me: bool
    collides: bool
    duration_s: float
    taxel_n: Vector
    flange_n: Vector


def _hands(taxel: int | None, force_n: float) -> Vector:
    return np.array([force_n if i == taxel else 0.0 for i in range(TAXELS)])


EXPERIMENTS = [
    Experiment("push", False, False, PUSH_S + REST_S, _hands(5, 20.0), np.zeros(6)),
    Experiment("b2-i", True, False, PUSH_S + REST_S, _hands(None, 0.0), np.array([15.0, 0, 0, 0, 0, 0])),
    Experiment("collision", False, True, COLLISION_S, _hands(None, 0.0), np.zeros(6)),
]


def run(experiment: Experiment, robot: Robot, build: Callable[[Robot, bool], Plant]) -> Trace:
    plant, controller, trace = build(robot, experiment.collides), Controller(robot, experiment.follow_me), Trace()
    felt, summed, shown = np.zeros(TAXELS), np.zeros(TAXELS), np.zeros(TAXELS)
    touched = TAXEL if experiment.collides else int(np.argmax(experiment.taxel_n))
    ticks = round(experiment.duration_s / CONTROL_PERIOD_S)
    for tick in range(-SETTLING_TICKS, ticks):
        t_s = tick * CONTROL_PERIOD_S
        if tick == 0:
            plant.begin()
            controller.target_velocity[1] = TARGET_M_S if experiment.collides else 0.0
        share = 0.0 if tick < 0 else float(np.clip(min(t_s, PUSH_S - t_s) / RAMP_S, 0.0, 1.0))
        hands, flange = share * experiment.taxel_n, share * experiment.flange_n
        summed += felt
        if (tick + SETTLING_TICKS + 1) % SENSOR_TICKS == 0:
            shown, summed = summed / SENSOR_TICKS, np.zeros(TAXELS)
        q, v = plant.state()
        command, at, wanted = controller.step(q, v, shown, flange)
        if tick >= 0:
            trace.rows.append(np.r_[t_s, q[:3], at, felt[touched]])
            trace.errors_m.append(float(np.linalg.norm(at - wanted)))
        plant.advance(command.base_velocity_body, command.arm_torque_nm, hands, flange)
        felt = hands.copy()
        felt[TAXEL] += plant.person_n()
    return trace
