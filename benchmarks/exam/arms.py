"""The arms of the exam: bare model files as an operator has them, and the properties of their drives and sensors.

The model files are written from the shipped arms without collision shapes. Torque limits are in the actuators.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from sim.arm import Arm, load_arm
from sim.mjcf import full_inertia, numbers, quaternion


@dataclass(frozen=True)
class Hardware:
    """Data sheet of an arm's drives and sensors, arrays (6,).

    log_rate: Hz of the recording; resolution: rad of a position reading; torque_noise: N m, std of one torque reading;
    speed_noise: rad/s; control_period: s; bandwidth: rad/s of the position loop; speed: factor on the speeds of the motions;
    heating: K that a joint warms up in steady motion, over heat_time s.
    """

    log_rate: float
    resolution: float
    torque_noise: np.ndarray
    speed_noise: float
    control_period: float
    bandwidth: float
    speed: float
    heating: float
    heat_time: float


HARDWARE = {
    # torque noise of the UR arms: about 6 % of the dry friction, similar to the ripple in published currents
    "ur10e": Hardware(125.0, 6e-6, np.array([1.2, 1.2, 0.55, 0.17, 0.17, 0.16]), 4e-3, 0.002, 45.0, 1.0, 30.0, 90.0),
    "ur5e": Hardware(250.0, 6e-6, np.array([0.65, 0.65, 0.6, 0.10, 0.10, 0.09]), 4e-3, 0.002, 55.0, 1.1, 30.0, 80.0),
    "servo6": Hardware(200.0, 9.6e-5, np.array([0.15, 0.15, 0.14, 0.046, 0.045, 0.042]), 6e-3, 0.002, 60.0, 1.1, 32.0, 60.0),
}


@cache
def model_text(name: str) -> str:
    """MJCF of a shipped arm with only bodies, joints and motors."""
    arm = load_arm(name)
    tree = arm.tree
    lines = [
        f'<mujoco model="{name}">',
        '  <compiler angle="radian" autolimits="true"/>',
        '  <option timestep="0.001" integrator="implicitfast"/>',
        "  <worldbody>",
    ]
    for j, joint in enumerate(tree.joint_names):
        pad = "    " + "  " * j
        limits = numbers((arm.q_min[j], arm.q_max[j]))
        lines += [
            f'{pad}<body name="{tree.link_names[j]}" pos="{numbers(tree.position[j])}" quat="{numbers(quaternion(tree.rotation[j]))}">',
            f'{pad}  <inertial mass="{float(tree.mass[j])!r}" pos="{numbers(tree.com[j])}" fullinertia="{numbers(full_inertia(tree.inertia[j]))}"/>',
            f'{pad}  <joint name="{joint}" type="hinge" axis="{numbers(tree.axis[j])}" range="{limits}" '
            f'frictionloss="{float(tree.frictionloss[j])!r}" damping="{float(tree.damping[j])!r}" armature="{float(tree.armature[j])!r}"/>',
        ]
    lines += ["    " + "  " * j + "</body>" for j in reversed(range(tree.n))]
    lines += ["  </worldbody>", "  <actuator>"]
    for j, joint in enumerate(tree.joint_names):
        top = float(arm.tau_max[j])
        lines.append(
            f'    <motor name="{joint.removesuffix("_joint")}" joint="{joint}" gear="1" ctrlrange="{-top!r} {top!r}"/>'
        )
    return "\n".join([*lines, "  </actuator>", "</mujoco>", ""])


def write_model(name: str, path: Path) -> Arm:
    """Write the bare model file of an arm and read it back as the operator's tool would."""
    path.write_text(model_text(name), encoding="utf-8")
    return load_arm(path)
