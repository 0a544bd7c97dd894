"""Passive physics of a MuJoCo model that an arm cannot have: named when the model is read, removed from exports.

An arm's dry and viscous friction, springs and reflected inertia are parameters of its joints. Its bodies have their full
weight, and only its drives and effects act on it. Its joints move independently of each other.
"""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

Element = ElementTree.Element
TENDON = ("stiffness", "damping", "armature", "frictionloss")
FLUID = ("density", "viscosity", "wind")
# flags of <option> that switch off what every arm has
SWITCHED_OFF = {
    "gravity": mujoco.mjtDisableBit.mjDSBL_GRAVITY, "frictionloss": mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS,
    "damper": mujoco.mjtDisableBit.mjDSBL_DAMPER, "spring": mujoco.mjtDisableBit.mjDSBL_SPRING,
    "actuation": mujoco.mjtDisableBit.mjDSBL_ACTUATION, "limit": mujoco.mjtDisableBit.mjDSBL_LIMIT,
}  # fmt: skip


def foreign_physics(model: mujoco.MjModel) -> list[str]:
    """What the model has and an arm cannot have, each with its place and MuJoCo's name for it."""
    kinds = mujoco.mjtObj

    def names(kind: mujoco.mjtObj, found: np.ndarray) -> str:
        return ", ".join(mujoco.mj_id2name(model, kind, int(k)) or f"number {k}" for k in np.flatnonzero(found))

    tendons = np.any(model.tendon_stiffnesspoly, axis=1) | np.any(model.tendon_dampingpoly, axis=1)
    for key in TENDON:
        tendons |= getattr(model, f"tendon_{key}") != 0
    own = np.array(
        [not (mujoco.mj_id2name(model, kinds.mjOBJ_TENDON, k) or "").startswith("calib_") for k in range(model.ntendon)]
    )
    fluid = [key for key in FLUID if np.any(getattr(model.opt, key))]
    off = [key for key, bit in SWITCHED_OFF.items() if model.opt.disableflags & bit]
    off += ["actuatorgroupdisable"] if model.opt.disableactuator else []
    rows = (
        ("gravcomp of body", names(kinds.mjOBJ_BODY, model.body_gravcomp != 0)),
        (
            "higher-order damping of joint",
            names(kinds.mjOBJ_JOINT, np.any(model.dof_dampingpoly[model.jnt_dofadr] != 0, axis=1)),
        ),
        ("higher-order stiffness of joint", names(kinds.mjOBJ_JOINT, np.any(model.jnt_stiffnesspoly != 0, axis=1))),
        ("higher-order damping of actuator", names(kinds.mjOBJ_ACTUATOR, np.any(model.actuator_dampingpoly != 0, axis=1))),
        (
            "stiffness, damping, armature and friction of tendon",
            names(kinds.mjOBJ_TENDON, tendons & own) if model.ntendon else "",
        ),
        ("option", ", ".join(fluid)),
        ("what the options disable:", ", ".join(off)),
        ("equality", names(kinds.mjOBJ_EQUALITY, np.ones(model.neq, dtype=bool))),
    )
    return [f"{what} {where}" for what, where in rows if where]


def without_foreign_physics(root: Element) -> None:
    """Remove it from the model text `root`; the damping of actuators keeps its linear term.

    `sim.mujoco_export` reduces damping and stiffness of joints to their linear terms.
    """
    for option in root.findall("option"):
        for key in FLUID:
            option.attrib.pop(key, None)
        option.attrib.pop("actuatorgroupdisable", None)
        for flag in option.findall("flag"):
            for key in SWITCHED_OFF:
                flag.attrib.pop(key, None)
    for equality in root.findall("equality"):
        root.remove(equality)
    for body in root.iter("body"):
        body.attrib.pop("gravcomp", None)
    for tendon in (e for place in root.findall("tendon") for e in place if not e.get("name", "").startswith("calib_")):
        tendon.attrib.update(dict.fromkeys(TENDON, "0"))
    for place in root.findall("actuator"):
        for motor in place:
            if len(motor.get("damping", "").split()) > 1:
                motor.set("damping", motor.get("damping", "").split()[0])
