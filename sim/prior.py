"""Uncertainty of an arm's numbers before any data: from their source, or from the arm's size if they are not stated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim.arm_table import Numbers, PriorTable
from sim.tree import GRAVITY, KinematicTree

if TYPE_CHECKING:
    from sim.arm import Arm

# relative standard deviations of mass, centre of mass (of the link's size) and inertia
WIDTHS: dict[Numbers, tuple[float, float, float]] = {
    "measured": (0.01, 0.01, 0.05),
    "cad": (0.05, 0.03, 0.15),
    "guessed": (0.5, 0.3, 1.0),
    "unknown": (3.0, 1.0, 3.0),
}
# share of the largest torque that dry friction, viscous friction at full speed, and an offset of the reading take in an ordinary drive
FRICTION_SHARE = 0.1
STATED = {"coulomb": "frictionloss", "viscous": "damping", "rotor": "armature"}


def stated_prior(numbers: Numbers | None, tree: KinematicTree) -> PriorTable:
    """The prior of a new arm, from the answer to "where do its numbers come from?"; without an answer they count as guessed.

    A quantity for which the model has no number (zero at every joint) is unknown. So is friction that was not measured: in
    model files it stabilises a simulation. Offsets of readings are unknown: no model file states them.
    """
    mass, com, inertia = WIDTHS[numbers or "guessed"]
    unknown = [key for key, row in STATED.items() if not np.any(getattr(tree, row))]
    if numbers != "measured":
        unknown = [key for key in STATED if key != "rotor" or numbers == "unknown" or key in unknown]
    return PriorTable.model_validate(
        {"numbers": numbers, "unknown": [*unknown, "offset"], "mass": mass, "com": com, "inertia": inertia}
    )


def bare_prior(tree: KinematicTree) -> PriorTable:
    """The prior of a bare model file: its numbers count as those of a calibrated model (the defaults of PriorTable).

    A quantity without a number (zero at every joint) is unknown.
    """
    return PriorTable.model_validate({"unknown": [key for key, row in STATED.items() if not np.any(getattr(tree, row))]})


def torque_scale(arm: Arm) -> np.ndarray:
    """(n,) N m: the arm's tau_max, or if it is not stated the weight of the links behind the joint at full reach."""
    return np.where(np.isfinite(arm.tau_max), arm.tau_max, weight(arm.tree))


def weight(tree: KinematicTree) -> np.ndarray:
    """(n,) N m: the weight of the links behind each joint at full reach."""
    return np.array(
        [GRAVITY * max(np.sqrt(_carried(tree, j) * tree.mass[_behind(tree, j)].sum()), 1e-3) for j in range(tree.n)]
    )


def spread(arm: Arm) -> dict[str, np.ndarray]:
    """Absolute standard deviations (n,) of coulomb N m, viscous N m s/rad, rotor kg m^2 and offset N m before any data.

    A stated number is one that is not listed in prior.unknown and not zero; a zero without a standard deviation of its own
    states nothing. Its deviation is relative to its value, but at least its own standard deviation. Any other deviation covers
    ordinary drives: a tenth of the largest torque, for viscous friction at full speed; for reflected inertia what the largest
    torque accelerates at ddq_max, or the inertia of the links behind it.
    """
    scale, prior, n = torque_scale(arm), arm.prior, arm.n
    speed = np.where(np.isfinite(arm.dq_max), arm.dq_max, 1.0)
    carried = np.array([_carried(arm.tree, j) for j in range(n)])
    wide = {
        "coulomb": FRICTION_SHARE * scale,
        "viscous": FRICTION_SHARE * scale / speed,
        "rotor": np.where(np.isfinite(arm.ddq_max), scale / np.where(np.isfinite(arm.ddq_max), arm.ddq_max, 1.0), carried),
        "offset": FRICTION_SHARE * scale,
    }
    relative = {"coulomb": prior.coulomb, "viscous": prior.viscous, "rotor": prior.rotor}
    for key, missing in unstated(arm).items():
        for j in np.flatnonzero(~missing):
            effect, parameter = EFFECT[key]
            own = arm.effect(effect, arm.joint_names[j])
            assert own
            value = abs(own.parameters[parameter])
            wide[key][j] = max(relative[key] * value, own.std.get(parameter, 0.0))
    return wide


EFFECT = {
    "coulomb": ("coulomb_friction", "coulomb"),
    "viscous": ("viscous_friction", "viscous"),
    "rotor": ("rotor_inertia", "inertia"),
}


def unstated(arm: Arm) -> dict[str, np.ndarray]:
    """For coulomb, viscous and rotor (n,) bool: the joints for which it is not stated.

    That is what prior.unknown lists, and a zero without a standard deviation of its own.
    """
    out = {}
    for key, (effect, parameter) in EFFECT.items():
        own = [arm.effect(effect, joint) for joint in arm.joint_names]
        silent = [e is None or not (e.parameters[parameter] or e.std.get(parameter)) for e in own]
        out[key] = np.array(silent) | (key in arm.prior.unknown)
    return out


def _behind(tree: KinematicTree, joint: int) -> list[int]:
    """Links that a joint moves, in order."""
    found = [joint]
    for i in range(joint + 1, tree.n):
        if tree.parent[i] in found:
            found.append(i)
    return found


def _carried(tree: KinematicTree, joint: int) -> float:
    """Inertia kg m^2 of the links behind a joint about its origin, as if all hung straight."""
    reach, total = {joint: 0.0}, 0.0
    for i in _behind(tree, joint):
        if i != joint:
            reach[i] = reach[int(tree.parent[i])] + float(np.linalg.norm(tree.position[i]))
        total += tree.mass[i] * (reach[i] + np.linalg.norm(tree.com[i])) ** 2 + np.trace(tree.inertia[i]) / 2
    return float(total)
