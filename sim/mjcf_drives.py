"""Joint ranges, motor limits and torque sensors of an exported MuJoCo model, as the arm has them."""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

from sim.arm import Arm
from sim.mjcf import numbers, section

Element = ElementTree.Element
READING = "calib_torque_{}"
FINER = 8  # factor by which a step may be shorter than the model's with its delays still covered
LEAST_LIMIT = 1e-9  # N m: MuJoCo takes no force range of zero


def set_range(element: Element, arm: Arm, model: mujoco.MjModel, j: int, degrees: bool) -> None:
    """Write the arm's joint range if the model has another or none."""
    span = np.array([arm.q_min[j], arm.q_max[j]])
    if np.isfinite(span).all() and not (model.jnt_limited[j] and np.allclose(span, model.jnt_range[j], rtol=1e-12, atol=1e-12)):
        turn = degrees and not arm.tree.prismatic[j]
        element.attrib.update(range=numbers(np.degrees(span) if turn else span), limited="true")


def set_limit(model: mujoco.MjModel, elements: list[Element], motors: list[Element], limits: list[float]) -> None:
    """Limit the motors together to the least of `limits`, N m at the joint, and each to its own; elements: the model's actuators in order."""
    for motor in motors if limits else []:
        k = elements.index(motor)
        least = min(limits) / len(motors) / max(abs(float(model.actuator_gear[k, 0])), 1e-12)
        if model.actuator_forcelimited[k]:
            least = min(least, float(np.abs(model.actuator_forcerange[k]).min()))
        motor.attrib.pop("forcelimited", None)
        least = max(least, LEAST_LIMIT)
        motor.set("forcerange", numbers([-least, least]))
        motor.set("forcelimited", "true")


def add_readings(root: Element, own: list[Element], arm: Arm, delay: float, step: float) -> None:
    """Add one sensor per motor for its force before the gear, with the delay of the arm's torque channel."""
    late = (
        {"delay": repr(delay), "nsample": str(int(np.ceil(delay * FINER / step)) + 2), "interp": "linear"} if delay > 0 else {}
    )
    sensors = section(root, "sensor")
    for old in [e for e in sensors if e.get("name", "").startswith("calib_")]:
        sensors.remove(old)
    for joint in arm.joint_names:
        for k, motor in enumerate(e for e in own if e.get("joint") == joint):
            if not motor.get("name"):
                motor.set("name", f"{joint}:motor_{k}")
            reading = {"name": READING.format(joint) + (f":{k}" if k else ""), "actuator": motor.get("name", "")}
            ElementTree.SubElement(sensors, "actuatorfrc", reading | late)
    if not len(sensors):
        root.remove(sensors)
