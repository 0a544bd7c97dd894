"""The compiled model of a plant: where its joints and motors stand in it, and its gears under the load of a pose."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from sim.arm import Arm
from sim.cell import BoxObstacle, MeshObstacle, PlaneObstacle
from sim.mjcf import TWIST, plant_text, twists
from sim.model import no_callback
from sim.rigid_body import RigidBody


def plant_model(
    arm: Arm, timestep: float, obstacles: Iterable[BoxObstacle | PlaneObstacle | MeshObstacle]
) -> tuple[mujoco.MjModel, np.ndarray, np.ndarray, list[tuple[int, int]], int]:
    """The model, the degree of freedom and the motor (n,) of each joint, joint and degree of freedom of each soft gear, the last body."""
    with no_callback():
        model = mujoco.MjModel.from_xml_string(plant_text(arm, timestep, obstacles))
    names = arm.joint_names
    dof = np.array([model.joint(n).dofadr[0] for n in names])
    motor = np.array([model.actuator(f"{n}:motor").id for n in names])
    twist = [(names.index(joint), int(model.joint(TWIST.format(joint=joint)).dofadr[0])) for joint in twists(arm)]
    return model, dof, motor, twist, model.body(arm.tree.link_names[-1]).id


def twist_gears(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: RigidBody, dof: np.ndarray, twist: Sequence[tuple[int, int]]
) -> None:
    """Twist soft gears until they carry the links, and put those with play against the stop that does; the links stay where they are."""
    q, dq = data.qpos[dof][None], data.qvel[dof][None]
    load = bodies.inverse_dynamics(q, dq, np.zeros_like(q))
    for j, gear in twist:
        hinge = model.dof_jntid[gear]
        stiffness, (low, high) = model.jnt_stiffness[hinge], model.jnt_range[hinge]
        angle = -load[0, j] / stiffness if stiffness > 0 else low if load[0, j] > 0 else high
        data.qpos[gear], data.qpos[dof[j]] = angle, data.qpos[dof[j]] - angle
    mujoco.mj_forward(model, data)
