"""Base and arm in MuJoCo from the URDF; foam, tissue, friction and person by the project's discrete rules."""

import mujoco
import numpy as np

from ..closed_loop import person as leg
from ..closed_loop.person import Person
from ..closed_loop.robot import (
    CONTROL_PERIOD_S,
    HOME_RAD,
    WHEEL_DAMPING,
    Robot,
    Vector,
    servo_step,
    turn,
    wheel_force,
)

STEP_S = CONTROL_PERIOD_S
ARM = slice(3, 10)


def model(robot: Robot) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(robot.urdf))
    spec.compiler.fusestatic = False
    # The taxels' plates have a shape and no mass.
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    base = spec.body("base_link")
    planar = [("base_x", mujoco.mjtJoint.mjJNT_SLIDE, [1, 0, 0]), ("base_y", mujoco.mjtJoint.mjJNT_SLIDE, [0, 1, 0])]
    planar.append(("base_yaw", mujoco.mjtJoint.mjJNT_HINGE, [0, 0, 1]))
    for (name, kind, axis), damping in zip(planar, WHEEL_DAMPING):
        base.add_joint(name=name, type=kind, axis=axis, damping=damping)
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    compiled = spec.compile()
    assert compiled.nv == 10, f"{compiled.nv} degrees of freedom"
    # Forces act at a body's centre of mass; a body without one gets its own offset in the parent for it.
    compiled.body_ipos[compiled.body("flange").id] = 0.0
    return compiled


class MujocoPlant:
    """One physics step a control period."""

    def __init__(self, robot: Robot, collides: bool) -> None:
        self._robot, self._model = robot, model(robot)
        self._data = mujoco.MjData(self._model)
        self._flange = self._model.body("flange").id
        self._data.qpos[ARM] = HOME_RAD
        mujoco.mj_forward(self._model, self._data)
        self._servo, self._felt_n = np.zeros(3), 0.0
        self._person = Person.before(robot) if collides else None
        self._moved, self._velocity = np.zeros(2), np.zeros(2)
        self._elastic_n = self._shear_m = 0.0
        self._time_s, self._touched_s = 0.0, 0.0
        self._away: Vector | None = None

    def state(self) -> tuple[Vector, Vector]:
        return self._data.qpos.copy(), self._data.qvel.copy()

    def person_n(self) -> float:
        return self._felt_n

    def begin(self) -> None:
        self._time_s = 0.0

    def advance(self, wanted_body: Vector, torque_nm: Vector, taxel_n: Vector, flange_wrench: Vector) -> None:
        self._servo = servo_step(self._servo, wanted_body)
        q, v = self.state()
        yaw = turn(q[2])
        push = yaw @ self._robot.cover_wrench(taxel_n) + self._meet(q, v)
        self._data.qfrc_applied[:3] = wheel_force(yaw @ self._servo, v[:3]) + push
        self._data.qfrc_applied[ARM] = torque_nm
        self._data.xfrc_applied[self._flange] = flange_wrench
        mujoco.mj_step(self._model, self._data)
        self._time_s += STEP_S

    def _meet(self, q: Vector, v: Vector) -> Vector:
        """Wrench of the leg on the base; moves the leg by one semi-implicit Euler step."""
        if self._person is None:
            return np.zeros(3)
        met = self._person.meeting(q, v, self._moved, self._velocity)
        self._felt_n, along_n = self._press(met)
        on_base, on_leg = self._person.forces(met, self._felt_n, along_n)
        if self._felt_n > 0 and self._away is None:
            self._touched_s, self._away = self._time_s, np.array(met.to_world(*self._person.outward))
        stepping_s = self._time_s - self._touched_s - leg.STEPS_AWAY_AFTER_S if self._away is not None else 0.0
        force = on_leg + leg.posture_n(self._moved, self._velocity, self._away, stepping_s)
        self._velocity = self._velocity + STEP_S * force / leg.MASS_KG
        self._moved = self._moved + STEP_S * self._velocity
        return on_base

    def _press(self, met: leg.Meeting) -> tuple[float, float]:
        """Normal force and friction: foam by backward Euler, the leg's own way in the step in series with its tissue."""
        if met.overlap_m <= 0:
            self._elastic_n = self._shear_m = 0.0
            return 0.0, 0.0
        give = STEP_S**2 / leg.MASS_KG
        tissue = leg.TISSUE_N_M / (1 + leg.TISSUE_N_M * give)
        rate = leg.FOAM_S / STEP_S

        def off_n(x_m: float) -> float:
            elastic_n = leg.foam_n(x_m)
            return max(elastic_n + rate * (elastic_n - self._elastic_n), 0.0) - tissue * (met.overlap_m - x_m)

        low, high = 0.0, min(met.overlap_m, 0.999 * leg.FOAM_M)
        for _ in range(200):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if off_n(middle) < 0 else (low, middle)
        x_m = 0.5 * (low + high)
        normal_n = off_n(x_m) + tissue * (met.overlap_m - x_m)
        self._elastic_n = leg.foam_n(x_m)
        return normal_n, self._friction(met, x_m, normal_n, give)

    def _friction(self, met: leg.Meeting, x_m: float, normal_n: float, give: float) -> float:
        """The foam shears until Coulomb's limit, then the leg slips."""
        if normal_n <= 0:
            self._shear_m = 0.0
            return 0.0
        stiffness = leg.SHEAR_SHARE * normal_n / x_m
        stiffness /= 1 + stiffness * give
        most_m = leg.FRICTION * normal_n / stiffness
        self._shear_m = float(np.clip(self._shear_m + STEP_S * met.sliding_m_s, -most_m, most_m))
        return -stiffness * self._shear_m
