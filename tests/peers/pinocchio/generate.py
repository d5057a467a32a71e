#!/usr/bin/env python3
"""Data for `moca-lab bench --anchor DIR`: the whole-body tick of a Panda on a planar base by Pinocchio and numpy.

    python3 -m venv venv && venv/bin/pip install pin==4.1.0 example-robot-data==6.0.0 numpy
    venv/bin/python generate.py DIR

The torques come from eq. (6) as it is printed, with explicit inverses: slow, and written without a line of this project.

| file | a row |
|---|---|
| model.csv | joints 1 to 7, then the tool in joint 7: rotation 9 (row major), translation 3, mass, centre of mass 3, inertia 9 |
| params.csv | mount 3, M_v 3, H 10, K_d 6, D_d 6, K_0 7, D_0 7, posture 7 |
| inputs.csv | base pose 3, joints 7, rates 10 (base in world axes), R_d 9 (row major), p_d 3, twist 6, base wrench 3 |
| ref.csv | torques 10 |
"""

import argparse
import pathlib
import sys

import numpy as np
import pinocchio as pin

MOUNT_M = np.array([0.1, 0.0, 0.45])
VIRTUAL_MASS = np.array([90.0, 90.0, 22.0])
WEIGHT = np.r_[[2.0] * 3, [1.25] * 7]
STIFFNESS = np.array([600.0, 600, 600, 40, 40, 40])
DAMPING = np.array([50.0, 50, 50, 6, 6, 6])
POSTURE_STIFFNESS = np.full(7, 12.0)
POSTURE_DAMPING = np.full(7, 2.0)
POSTURE_RAD = np.array([0, -0.6, 0, -2.2, 0, 1.7, 0.785])
TOOL = "panda_hand_tcp"


URDF = "cmeel.prefix/share/example-robot-data/robots/panda_description/urdf/panda.urdf"


class Arm:
    """The Panda of example-robot-data with its fingers locked."""

    def __init__(self):
        found = [file for folder in sys.path if (file := pathlib.Path(folder, URDF)).exists()]
        if not found:
            sys.exit(f"{URDF} is in no folder of sys.path: pip install example-robot-data")
        whole = pin.buildModelFromUrdf(str(found[0]))
        fingers = [whole.getJointId(name) for name in whole.names if "finger" in name]
        self.model = pin.buildReducedModel(whole, fingers, np.zeros(whole.nq))
        self.data = self.model.createData()
        self.tool = self.model.getFrameId(TOOL)

    def rows(self):
        for joint in range(1, 8):
            place, inertia = self.model.jointPlacements[joint], self.model.inertias[joint]
            yield np.r_[place.rotation.ravel(), place.translation, inertia.mass, inertia.lever, inertia.inertia.ravel()]
        place = self.model.frames[self.tool].placement
        yield np.r_[place.rotation.ravel(), place.translation, np.zeros(13)]

    def tool_in_world(self, base_pose, q):
        """Base rotation, tool rotation, tool position, all in the world."""
        pin.forwardKinematics(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, base_pose[2])
        tool = self.data.oMf[self.tool]
        origin = np.r_[base_pose[:2], 0.0] + turn @ MOUNT_M
        return turn, turn @ tool.rotation, origin + turn @ tool.translation

    def draw(self, random):
        base_pose = random.uniform([-2, -2, -3.1], [2, 2, 3.1])
        low, high = self.model.lowerPositionLimit, self.model.upperPositionLimit
        q = low + (high - low) * random.uniform(0.1, 0.9, 7)
        rates = random.uniform(-1, 1, 10) * np.r_[[0.5] * 3, [1.0] * 7]
        wrench = random.uniform(-20, 20, 3)
        _, rotation, position = self.tool_in_world(base_pose, q)
        rotation = rotation @ pin.exp3(random.uniform(-0.2, 0.2, 3))
        position = position + random.uniform(-0.05, 0.05, 3)
        return np.r_[base_pose, q, rates, rotation.ravel(), position, random.uniform(-0.2, 0.2, 6), wrench]

    def torques(self, row):
        base_pose, q, rates = row[:3], row[3:10], row[10:20]
        desired_rotation, desired_position = row[20:29].reshape(3, 3), row[29:32]
        twist, wrench = row[32:38], row[38:41]
        turn, rotation, position = self.tool_in_world(base_pose, q)
        arm_jacobian = pin.computeFrameJacobian(self.model, self.data, q, self.tool, pin.LOCAL_WORLD_ALIGNED)
        jacobian = np.zeros((6, 10))
        jacobian[:, 3:] = np.kron(np.eye(2), turn) @ arm_jacobian
        jacobian[0, 0] = jacobian[1, 1] = jacobian[5, 2] = 1.0
        jacobian[:3, 2] = np.cross([0, 0, 1], position - np.r_[base_pose[:2], 0.0])
        mass = np.zeros((10, 10))
        mass[:3, :3] = np.diag(VIRTUAL_MASS)
        upper = np.triu(pin.crba(self.model, self.data, q))
        mass[3:, 3:] = upper + np.triu(upper, 1).T
        bias = pin.nonLinearEffects(self.model, self.data, q, rates[3:])

        turned = sum(np.cross(rotation[:, k], desired_rotation[:, k]) for k in range(3)) / 2
        error = np.r_[desired_position - position, turned]
        force = DAMPING * (twist - jacobian @ rates) + STIFFNESS * error
        own = np.r_[wrench, POSTURE_STIFFNESS * (POSTURE_RAD - q) - POSTURE_DAMPING * rates[3:]]
        inverse = np.linalg.inv(mass)
        h = np.diag(WEIGHT)
        weight_inverse = np.linalg.inv(h.T @ inverse @ h)
        spread = weight_inverse @ inverse @ jacobian.T
        spread = spread @ np.linalg.inv(jacobian @ inverse @ spread)
        torques = spread @ (jacobian @ inverse @ jacobian.T) @ force
        torques += (np.eye(10) - spread @ jacobian @ inverse) @ own
        torques[3:] += bias
        return torques


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("folder", type=pathlib.Path)
    arguments.add_argument("--inputs", type=int, default=256)
    arguments.add_argument("--seed", type=int, default=1)
    chosen = arguments.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    arm, random = Arm(), np.random.default_rng(chosen.seed)
    inputs = np.array([arm.draw(random) for _ in range(chosen.inputs)])
    parameters = np.r_[
        MOUNT_M, VIRTUAL_MASS, WEIGHT, STIFFNESS, DAMPING, POSTURE_STIFFNESS, POSTURE_DAMPING, POSTURE_RAD
    ]
    tables = {
        "model": np.array(list(arm.rows())),
        "params": parameters[None, :],
        "inputs": inputs,
        "ref": np.array([arm.torques(row) for row in inputs]),
    }
    for name, table in tables.items():
        np.savetxt(chosen.folder / f"{name}.csv", table, delimiter=",", fmt="%.17g")


if __name__ == "__main__":
    main()
