"""Compiled model of a plant, the indices of its joints and motors, and its gears and dry friction under the load of a pose."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from sim.arm import Arm, ArmEffect
from sim.cell import BoxObstacle, MeshObstacle, PlaneObstacle
from sim.effects import Stage
from sim.effects.effect import Effect
from sim.errors import ConfigError
from sim.instant import apply_all
from sim.mjcf import TWIST, plant_text, twists
from sim.model import no_callback
from sim.prediction import Stages, put_load
from sim.rigid_body import RigidBody
from sim.slip import slip_direction
from sim.torque_path import PathState

Steps = Mapping[Stage, Sequence[tuple[Effect, int | None, ArmEffect]]]


def plant_model(
    arm: Arm, timestep: float, obstacles: Iterable[BoxObstacle | PlaneObstacle | MeshObstacle]
) -> tuple[mujoco.MjModel, np.ndarray, np.ndarray, list[tuple[int, int]], int]:
    """Model, degree of freedom (n,) and motor (n,) of each joint, joint and degree of freedom of each soft gear, last body.

    ConfigError if MuJoCo refuses the arm, for example for an inertia that no body has.
    """
    with no_callback():
        try:
            model = mujoco.MjModel.from_xml_string(plant_text(arm, timestep, obstacles))
        except ValueError as error:
            raise ConfigError(
                f"{arm.name}: MuJoCo cannot simulate it ({' '.join(str(error).split())}); correct its model"
            ) from None
    names = arm.joint_names
    dof = np.array([model.joint(n).dofadr[0] for n in names])
    motor = np.array([model.actuator(f"{n}:motor").id for n in names])
    twist = [(names.index(joint), int(model.joint(TWIST.format(joint=joint)).dofadr[0])) for joint in twists(arm)]
    return model, dof, motor, twist, model.body(arm.tree.link_names[-1]).id


def twist_gears(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: RigidBody, dof: np.ndarray, twist: Sequence[tuple[int, int]]
) -> None:
    """Twist soft gears until they carry the links, and move gears with backlash to the stop that does; the links do not move."""
    q, dq = data.qpos[dof][None], data.qvel[dof][None]
    load = bodies.inverse_dynamics(q, dq, np.zeros_like(q))
    for j, gear in twist:
        hinge = model.dof_jntid[gear]
        stiffness, (low, high) = model.jnt_stiffness[hinge], model.jnt_range[hinge]
        angle = -load[0, j] / stiffness if stiffness > 0 else low if load[0, j] > 0 else high
        data.qpos[gear], data.qpos[dof[j]] = angle, data.qpos[dof[j]] - angle
    mujoco.mj_forward(model, data)


def load_gears(state: PathState, stages: Stages, bodies: RigidBody) -> None:
    """Set the load on the gears at one instant: what links, external forces, springs and couplings need at its acceleration."""
    put_load(state, stages, bodies)
    apply_all(state, stages[Stage.JOINT])


def along(one: PathState, way: np.ndarray, stages: Stages, bodies: RigidBody) -> PathState:
    """Path of one instant, repeated with the motors at each of `way` (K, n) rad that led up to it, with the load at it."""
    load_gears(one, stages, bodies)
    every: dict[str, Any] = {k: np.repeat(v, len(way), axis=0) for k, v in vars(one).items() if v is not None}
    state = PathState(**every)
    state.q_motor = way
    return state


def loaded(
    state: PathState, stages: Steps, each_step: Steps, presliding: Sequence[int], memory: dict[Hashable, np.ndarray]
) -> list[float]:
    """Update the memory of dry friction along a path; return the final slip of the joints `presliding`."""
    apply_all(state, stages[Stage.FRICTION])
    slip = [float(slip_direction(state.q_motor[:, j], state.width[:, j])[-1]) for j in presliding]
    state.memory = memory
    apply_all(state, each_step[Stage.MOTOR])
    return slip
