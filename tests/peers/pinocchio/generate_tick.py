#!/usr/bin/env python3
"""The whole tick as one C function: kinematics, dynamics and eq. (6) in block form as CasADi expressions, written out.

usage: generate_tick.py DIR

Reads model.csv and params.csv, which generate.py writes; their numbers become constants of DIR/casadi_tick.c. Its one input
is a row of inputs.csv, its one output the ten torques.
"""

import pathlib
import sys

import casadi as ca
import numpy as np

GRAVITY = np.array([0.0, 0.0, 9.81])


def about_z(angle):
    cos, sin = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(cos, -sin, 0), ca.horzcat(sin, cos, 0), ca.horzcat(0, 0, 1))


def chain(model, turn, q):
    """Axes and origin (from the arm's base, world axes) of each link and of the tool."""
    axes, place, links = turn, ca.SX.zeros(3), []
    for joint, row in enumerate(model):
        place = place + axes @ row[9:12]
        axes = axes @ row[:9].reshape(3, 3)
        if joint < 7:
            axes = axes @ about_z(q[joint])
        links.append((axes, place))
    return links


def newton_euler(model, links, rates, accelerations, gravity):
    """Joint torques on a standing base, world axes throughout."""
    omega, alpha, acceleration, forces = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX(gravity), []
    before = ca.SX.zeros(3)
    for (axes, place), row, rate, turning in zip(links, model, rates, accelerations):
        arm, axis = place - before, axes[:, 2]
        acceleration = acceleration + ca.cross(alpha, arm) + ca.cross(omega, ca.cross(omega, arm))
        alpha = alpha + axis * turning + ca.cross(omega, axis) * rate
        omega = omega + axis * rate
        com = axes @ row[13:16]
        inertia = axes @ row[16:25].reshape(3, 3) @ axes.T
        force = row[12] * (acceleration + ca.cross(alpha, com) + ca.cross(omega, ca.cross(omega, com)))
        moment = inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(com, force)
        forces.append((force, moment))
        before = place
    force, moment, torques = ca.SX.zeros(3), ca.SX.zeros(3), []
    for i in reversed(range(7)):
        axes, place = links[i]
        if i < 6:
            moment = moment + ca.cross(links[i + 1][1] - place, force)
        force, moment = force + forces[i][0], moment + forces[i][1]
        torques.append(ca.dot(axes[:, 2], moment))
    return ca.vertcat(*reversed(torques))


def mass_matrix(model, links):
    """Composite bodies from the tip, world axes about each joint's origin."""
    mass = ca.SX.zeros(7, 7)
    whole, moment, inertia = 0, ca.SX.zeros(3), ca.SX.zeros(3, 3)
    for i in reversed(range(7)):
        axes, place = links[i]
        com = place + axes @ model[i][13:16]
        own = axes @ model[i][16:25].reshape(3, 3) @ axes.T
        # About the arm's base: nothing has to be moved from joint to joint.
        whole, moment = whole + model[i][12], moment + model[i][12] * com
        inertia = inertia + own + model[i][12] * (ca.dot(com, com) * ca.SX.eye(3) - com @ com.T)
        axis = axes[:, 2]
        swept = ca.cross(place, axis)
        angular = inertia @ axis + ca.cross(moment, swept)
        linear = whole * swept - ca.cross(moment, axis)
        for j in range(i + 1):
            other = links[j][0][:, 2]
            mass[j, i] = mass[i, j] = ca.dot(other, angular) + ca.dot(ca.cross(links[j][1], other), linear)
    return mass


def cholesky_solve(matrix, right):
    """L⁻¹ of a symmetric positive-definite matrix applied to `right`, and L."""
    size = matrix.shape[0]
    low, solved = ca.SX.zeros(size, size), ca.SX(right)
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[i, j] - sum(low[i, k] * low[j, k] for k in range(j))
            low[i, j] = ca.sqrt(rest) if i == j else rest / low[j, j]
        solved[i, :] = (solved[i, :] - low[i, :i] @ solved[:i, :]) / low[i, i] if i else solved[i, :] / low[i, i]
    return solved, low


def back(low, right):
    solved = ca.SX(right)
    for i in reversed(range(low.shape[0])):
        below = ca.dot(low[i + 1 :, i], solved[i + 1 :]) if i + 1 < low.shape[0] else 0
        solved[i] = (solved[i] - below) / low[i, i]
    return solved


def tick(model, parameters):
    cuts = np.cumsum([3, 3, 10, 6, 6, 7, 7])
    mount, virtual_mass, weight, stiffness, damping, posture_stiffness, posture_damping, posture = np.split(parameters, cuts)
    assert len(set(weight[:3])) == len(set(weight[3:])) == 1, "H is not one number a block"
    row = ca.SX.sym("row", 41)
    base, q, rates = row[:3], row[3:10], row[10:20]
    desired_rotation, desired = ca.reshape(row[20:29], 3, 3).T, row[29:32]
    twist, wrench = row[32:38], row[38:41]
    turn = about_z(base[2])
    links = chain(model, turn, q)
    rotation, tool = links[7]
    lever = turn @ mount + tool
    jacobian = ca.SX.zeros(6, 10)
    jacobian[0, 0] = jacobian[1, 1] = jacobian[5, 2] = 1
    jacobian[0, 2], jacobian[1, 2] = -lever[1], lever[0]
    for i in range(7):
        axis = links[i][0][:, 2]
        jacobian[:3, 3 + i], jacobian[3:, 3 + i] = ca.cross(axis, tool - links[i][1]), axis
    turned = sum(ca.cross(rotation[:, k], desired_rotation[:, k]) for k in range(3)) / 2
    error = ca.vertcat(desired - (lever + ca.vertcat(base[:2], 0)), turned)
    force = damping * (twist - jacobian @ rates) + stiffness * error
    null = ca.vertcat(wrench, posture_stiffness * (posture - q) - posture_damping * rates[3:])
    wanted = jacobian.T @ force - null
    of_base, of_arm = 1 / weight[0] ** 2, 1 / weight[3] ** 2
    solved, _ = cholesky_solve(mass_matrix(model, links), ca.horzcat(jacobian[:, 3:].T, wanted[3:]))
    y, right = solved[:, :6], solved[:, 6]
    light = ca.diag(1 / virtual_mass) @ jacobian[:, :3].T
    inner = of_arm * y.T @ y + of_base * jacobian[:, :3] @ light
    forward, low = cholesky_solve(inner, y.T @ right + light.T @ wanted[:3])
    z = back(low, forward)
    torque = null + ca.vertcat(of_base * jacobian[:, :3].T @ z, of_arm * jacobian[:, 3:].T @ z)
    bias = newton_euler(model, links, ca.vertsplit(rates[3:]), [0] * 7, GRAVITY)
    torque = ca.cse(torque + ca.vertcat(ca.SX.zeros(3), bias))
    return ca.Function("casadi_tick", [row], [torque])


def main():
    folder = pathlib.Path(sys.argv[1])
    model, parameters = (np.loadtxt(folder / f"{name}.csv", delimiter=",") for name in ("model", "params"))
    function = tick(list(model), parameters)
    generator = ca.CodeGenerator("casadi_tick.c")
    generator.add(function)
    generator.generate(f"{folder}/")
    print(f"{function.n_instructions()} instructions", file=sys.stderr)


if __name__ == "__main__":
    main()
