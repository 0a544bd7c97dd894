"""The true arm of a case in terms of the catalogue: the result of a perfect identification.

Bodies, friction, reflected inertia and gravity are the true ones, and hidden effects have their true parameters. What the
catalogue does not have is left out: gear mesh, warming, second harmonics, other forms of an effect. The arm predicts from
readings like any other.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.exam.true_arm import TrueArm
from sim.arm import Arm, ArmEffect
from sim.arm_folder import write_arm
from sim.effects import effect_named
from sim.effects.effect import Stage

IN_MODEL = {
    "coulomb_friction": ("frictionloss", "coulomb"), "viscous_friction": ("damping", "viscous"), "rotor_inertia": ("armature", "inertia"),
}  # fmt: skip
PHASE = {"torque_ripple": "ripple_phase", "encoder_eccentricity": "wobble_phase"}


def write_true(arm: TrueArm, nominal: Arm, hidden: list[dict[str, Any]], folder: Path) -> None:
    """Write an arm folder of `arm` with the effects `hidden` (effect, joint, parameters)."""
    names = nominal.joint_names
    mass, com, inertia = arm.chain[3:]
    own = {
        name: {"frictionloss": float(x["coulomb"]), "damping": float(x["viscous"]), "armature": float(x["rotor"])}
        for name, x in zip(names, arm.joints, strict=True)
    }
    others = []
    for item in hidden:
        name, joint, values = item["effect"], item["joint"], dict(item["parameters"])
        if name in IN_MODEL:
            key, parameter = IN_MODEL[name]
            own[joint][key] = values[parameter]
        elif name != "unknown" and effect_named(name).stage is not Stage.RIGID:
            if name in PHASE:
                values["phase"] = float(arm.joints[PHASE[name]][names.index(joint)])
            # an answer without all parameters has no form in the catalogue: friction by the joint's own temperature
            if {p.name for p in effect_named(name).parameters} == set(values) and name != "external_contact":
                others.append(ArmEffect(name, joint, values))
    write_arm(
        folder, nominal, name=f"{nominal.name}_true", inertials={name: (float(m), c, i) for name, m, c, i in zip(names, mass, com, inertia, strict=True)},
        joints=own, gravity=arm.gravity, effects=others,
    )  # fmt: skip
