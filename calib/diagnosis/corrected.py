"""The corrected arm: the named effects, and the ordinary parameters where the same fit puts them within their priors.

A name and a refit belong together: with the effect missing, the ordinary parameters would take its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.model import CONTACT, ROTOR_TOGETHER
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect

Inertial = tuple[float, np.ndarray, np.ndarray]
FRICTION = {"coulomb_friction": "Fc", "viscous_friction": "Fv", "rotor_inertia": "Ia"}


@dataclass(frozen=True)
class Correction:
    """Changes of an arm: joint -> (mass kg, com (3,) m, inertia (3, 3) kg m^2 about it) of the link behind it, and effects."""

    inertials: dict[str, Inertial]
    effects: tuple[ArmEffect, ...]

    def of(self, arm: Arm) -> Arm:
        """The arm with these changes."""
        for item in self.effects:
            arm = with_effect(arm, item)
        mass, com, inertia = arm.tree.mass.copy(), arm.tree.com.copy(), arm.tree.inertia.copy()
        for joint, (m, c, i) in self.inertials.items():
            j = arm.joint_index(joint)
            mass[j], com[j], inertia[j] = m, c, i
        return replace(arm, tree=replace(arm.tree, mass=mass, com=com, inertia=inertia))


def correction(f: Fit, limits: Sequence[ArmEffect] = ()) -> Correction:
    """The accepted effects with their standard deviations, what the nuisance of the fit says of masses, friction and rotors, and limits.

    A contact is an event and not a property. A link whose inertia is named, and the last one under a payload, stay as they are named.
    """
    model, start = f.models[0], f.hypothesis.start
    theta = dict(zip(model.names, f.solved.theta, strict=True))
    named = [(e, s) for e, s in zip(f.accepted, f.std(), strict=True) if e.effect != CONTACT]
    taken = {e.joint for e, _ in named if e.effect == "link_inertia"}
    if any(e.effect == "payload" for e, _ in named):
        taken.add(start.joint_names[-1])
    inertials = {joint: _inertial(start, i, theta) for i, joint in enumerate(start.joint_names) if joint not in taken}
    effects = [replace(e, parameters=_scaled(model.own_spread, e, start, theta), std=_finite(s)) for e, s in named]
    have = {(e.effect, e.joint) for e, _ in named}
    effects += [
        replace(e, parameters=_scaled(model.own_spread, e, start, theta))
        for e in start.effects
        if e.effect in FRICTION and (e.effect, e.joint) not in have
    ]
    return Correction(inertials, (*effects, *limits))


def _inertial(arm: Arm, i: int, theta: dict[str, float]) -> Inertial:
    """Link i: m scales all of it, c moves its centre, I scales its inertia about the centre; a scale never falls below a tenth."""
    prior, tree, k = arm.prior, arm.tree, i + 1
    scale = max(0.1, 1.0 + prior.mass * theta[f"m_{k}"])
    wider = max(0.1, 1.0 + prior.inertia * theta[f"I_{k}"])
    size = max(float(np.linalg.norm(tree.com[i])), 0.005)
    moved = prior.com * size * np.array([theta[f"c{axis}_{k}"] for axis in "xyz"])
    return float(tree.mass[i] * scale), tree.com[i] + moved, tree.inertia[i] * scale * wider


def _scaled(spread: dict[tuple[str, str], float], item: ArmEffect, arm: Arm, theta: dict[str, float]) -> dict[str, float]:
    """Friction and rotors with the nuisance's relative change; other effects as they are."""
    if item.effect not in FRICTION or item.joint is None:
        return dict(item.parameters)
    k = arm.joint_index(item.joint) + 1
    change = spread[item.effect, item.joint] * theta[f"{FRICTION[item.effect]}_{k}"]
    if item.effect == "rotor_inertia":
        change += ROTOR_TOGETHER * theta["Ia_all"]
    return {name: value * max(0.1, 1.0 + change) for name, value in item.parameters.items()}


def _finite(std: dict[str, float]) -> dict[str, float]:
    return {k: v for k, v in std.items() if np.isfinite(v) and v > 0}
