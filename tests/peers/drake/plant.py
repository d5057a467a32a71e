"""Base, arm and leg as one continuous system in Drake; wheels, foam and posture are forces inside its integrator.

Neither the dynamics nor the integrator nor the contact is the project's: the foam is a state of its own, F_e with
T·dF_e/dt = F − F_e, and the integrator's step follows its error. Without friction, which has no derivative where the leg
begins to slip. Drake's CENIC integrator is no anchor for this scene (tests/peers/README.md).
"""

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import BasicVector, Context, ContinuousState, DiagramBuilder, LeafSystem

from ..closed_loop import person as leg
from ..closed_loop.person import Meeting, Person
from ..closed_loop.robot import CONTROL_PERIOD_S, HOME_RAD, WHEEL_DAMPING, Robot, Vector, servo_step, turn, wheel_force

SCHEME, ACCURACY = "runge_kutta3", 1e-8
JOINTS = ["base_x", "base_y", "base_yaw", *(f"arm_joint{i}" for i in range(1, 8)), "person_x", "person_y"]
NEVER_S = 1e9


class Loads(LeafSystem):
    """Generalised forces on the plant from its state and from what holds for a control period.

    `held`: the wheels' velocity (body), the arm's torques, the hands' wrench on the base (body). `walk`: when the leg steps
    away, and in which direction.
    """

    def __init__(self, person: Person) -> None:
        super().__init__()
        self._person = person
        self.state_in = self.DeclareVectorInputPort("state", 2 * len(JOINTS))
        self.held = self.DeclareVectorInputPort("held", 13)
        self.walk = self.DeclareVectorInputPort("walk", 3)
        self.DeclareContinuousState(1)
        self.DeclareVectorOutputPort("force", len(JOINTS), self._force)

    def touch(self, context: Context) -> tuple[Meeting, float]:
        state = self.state_in.Eval(context)
        q, v = state[: len(JOINTS)], state[len(JOINTS) :]
        met = self._person.meeting(q, v, q[10:], v[10:])
        elastic_n = max(context.get_continuous_state_vector().GetAtIndex(0), 0.0)
        pressed = leg.TISSUE_N_M * (met.overlap_m - leg.foam_m(elastic_n))
        return met, max(pressed, 0.0) if met.overlap_m > 0 else 0.0

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        elastic_n = context.get_continuous_state_vector().GetAtIndex(0)
        derivatives.get_mutable_vector().SetAtIndex(0, (self.touch(context)[1] - elastic_n) / leg.FOAM_S)

    def _force(self, context: Context, output: BasicVector) -> None:
        state, held, walk = (port.Eval(context) for port in (self.state_in, self.held, self.walk))
        q, v = state[: len(JOINTS)], state[len(JOINTS) :]
        yaw = turn(q[2])
        met, normal_n = self.touch(context)
        on_base, on_leg = self._person.forces(met, normal_n, 0.0)
        posture = leg.posture_n(q[10:], v[10:], walk[1:], context.get_time() - walk[0])
        # The joints' own damping is the wheels' viscous part.
        wheels = wheel_force(yaw @ held[:3], v[:3]) + yaw @ held[10:] + on_base
        output.SetFromVector(np.r_[wheels, held[3:10], on_leg + posture])


class DrakePlant:
    """One control period is one call of the simulator."""

    def __init__(self, robot: Robot, collides: bool, scheme: str = SCHEME, accuracy: float = ACCURACY) -> None:
        person = Person.before(robot)
        if not collides:
            person = Person(person.start_m + 50.0 * person.outward, person.outward, person.on_cover_m)
        self._robot, self._person, self._servo = robot, person, np.zeros(3)
        builder = DiagramBuilder()
        self._plant = builder.AddNamedSystem("robot", _multibody(robot))
        self._loads = builder.AddNamedSystem("loads", Loads(person))
        builder.Connect(self._plant.get_state_output_port(), self._loads.state_in)
        builder.Connect(self._loads.GetOutputPort("force"), self._plant.get_applied_generalized_force_input_port())
        self._simulator = Simulator(builder.Build())
        root = self._simulator.get_mutable_context()
        self._plant_context = self._plant.GetMyMutableContextFromRoot(root)
        self._loads_context = self._loads.GetMyMutableContextFromRoot(root)
        self._plant.SetPositions(self._plant_context, np.r_[np.zeros(3), HOME_RAD, np.zeros(2)])
        self._held = self._loads.held.FixValue(self._loads_context, np.zeros(13))
        self._walk = self._loads.walk.FixValue(self._loads_context, np.array([NEVER_S, 0.0, 0.0]))
        port = self._plant.get_applied_spatial_force_input_port()
        self._pull = port.FixValue(self._plant_context, Value(self._pulled(np.zeros(6))))
        self.integrator = ResetIntegratorFromFlags(self._simulator, scheme, CONTROL_PERIOD_S)
        self.integrator.set_target_accuracy(accuracy)
        self._simulator.Initialize()
        self._time_s, self._overlap_m = 0.0, -leg.GAP_M

    def state(self) -> tuple[Vector, Vector]:
        context = self._plant_context
        return self._plant.GetPositions(context)[:10], self._plant.GetVelocities(context)[:10]

    def person_n(self) -> float:
        return self._loads.touch(self._loads_context)[1]

    def begin(self) -> None:
        """The person waits for the touch alone."""

    def advance(self, wanted_body: Vector, torque_nm: Vector, taxel_n: Vector, flange_wrench: Vector) -> None:
        self._servo = servo_step(self._servo, wanted_body)
        held = np.r_[self._servo, torque_nm, self._robot.cover_wrench(taxel_n)]
        self._held.GetMutableData().get_mutable_value().SetFromVector(held)
        self._pull.GetMutableData().set_value(self._pulled(flange_wrench))
        self._time_s += CONTROL_PERIOD_S
        self._simulator.AdvanceTo(self._time_s)
        met, normal_n = self._loads.touch(self._loads_context)
        if normal_n > 0 and self._walk_s() == NEVER_S:
            since_s = CONTROL_PERIOD_S * met.overlap_m / (met.overlap_m - self._overlap_m)
            away = met.to_world(*self._person.outward)
            walk = np.r_[self._time_s - since_s + leg.STEPS_AWAY_AFTER_S, away]
            self._walk.GetMutableData().get_mutable_value().SetFromVector(walk)
        self._overlap_m = met.overlap_m

    def _walk_s(self) -> float:
        return float(self._loads.walk.Eval(self._loads_context)[0])

    def _pulled(self, wrench: Vector) -> list[ExternallyAppliedSpatialForce]:
        pull = ExternallyAppliedSpatialForce()
        pull.body_index = self._plant.GetBodyByName("flange").index()
        pull.p_BoBq_B = np.zeros(3)
        pull.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
        return [pull]


def _multibody(robot: Robot) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(robot.urdf))
    base = plant.GetBodyByName("base_link")
    instance = base.model_instance()

    def carriage(name: str) -> RigidBody:
        return plant.AddRigidBody(name, instance, SpatialInertia.Zero())

    x, y, world = carriage("carriage_x"), carriage("carriage_y"), plant.world_frame()
    along_x, along_y, up = np.eye(3)
    plant.AddJoint(PrismaticJoint("base_x", world, x.body_frame(), along_x, damping=WHEEL_DAMPING[0]))
    plant.AddJoint(PrismaticJoint("base_y", x.body_frame(), y.body_frame(), along_y, damping=WHEEL_DAMPING[1]))
    plant.AddJoint(RevoluteJoint("base_yaw", y.body_frame(), base.body_frame(), up, damping=WHEEL_DAMPING[2]))
    side = carriage("carriage_person")
    body = SpatialInertia(leg.MASS_KG, np.zeros(3), UnitInertia.SolidSphere(0.2))
    person = plant.AddRigidBody("person", instance, body)
    plant.AddJoint(PrismaticJoint("person_x", world, side.body_frame(), along_x))
    plant.AddJoint(PrismaticJoint("person_y", side.body_frame(), person.body_frame(), along_y))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -9.81])
    plant.Finalize()
    assert [plant.GetJointByName(name).velocity_start() for name in JOINTS] == list(range(len(JOINTS)))
    return plant
