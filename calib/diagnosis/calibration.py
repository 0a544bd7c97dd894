"""What an ordinary refit of the arm's own numbers takes up: which of them moved, how far, and how sure that is.

An effect that looks like a heavier link, another friction level or a late reading is no name, but it is an answer.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.model import DELAY_SPREAD, centre_size, spreads
from sim.arm import Arm

MOVED, EVIDENT = 1.0, 9.0  # prior standard deviations, and Wald statistic, to be listed
FRICTION = {
    "Fc": ("Coulomb friction", "coulomb", "N*m"),
    "Fv": ("viscous friction", "viscous", "N*m*s/rad"),
    "Ia": ("reflected inertia", "rotor", "kg*m^2"),
    "offset": ("torque offset", "offset", "N*m"),
}


@dataclass(frozen=True)
class Moved:
    """One number of the arm: what it is, its change and unit, in prior standard deviations, and the Wald statistic of that change."""

    what: str
    joint: str | None
    change: float
    unit: str
    deviations: float
    evidence: float

    def entry(self) -> dict[str, object]:
        """As diagnosis.json has it."""
        return {
            "parameter": self.what,
            "joint": self.joint,
            "change": self.change,
            "unit": self.unit,
            "prior_deviations": self.deviations,
            "wald": self.evidence,
        }


def calibration(refit: Fit) -> list[Moved]:
    """The numbers that moved by more than a prior standard deviation and significantly, farthest first."""
    arm, names = refit.hypothesis.start, refit.models[0].names
    theta, variance = refit.solved.theta, np.diag(refit.solved.inverse)
    out = []
    for name, moved, spread in zip(names, theta, variance, strict=False):
        evidence = float(moved**2 / max(float(spread), 1e-12))
        if abs(moved) >= MOVED and evidence >= EVIDENT and (found := _meaning(arm, name)) is not None:
            what, joint, unit, size = found
            out.append(Moved(what, joint, float(moved) * size, unit, float(moved), evidence))
    return sorted(out, key=lambda x: -abs(x.deviations))


def _meaning(arm: Arm, name: str) -> tuple[str, str | None, str, float] | None:
    """What a nuisance parameter is, its joint, its unit and one prior standard deviation of it."""
    if name == "delay":
        return "delay of the torque reading", None, "ms", 1e3 * DELAY_SPREAD
    match = re.fullmatch(r"(m|cx|cy|cz|I|Fc|Fv|Ia|offset)_(\d+)", name)
    if match is None:
        return None
    kind, j = match[1], int(match[2]) - 1
    joint, prior = arm.joint_names[j], arm.prior
    if kind in FRICTION:
        what, key, unit = FRICTION[kind]
        return what, joint, unit, float(spreads(arm)[key][j])
    if kind == "m":
        return "mass of the link", joint, "kg", float(prior.mass * arm.tree.mass[j])
    if kind == "I":
        return "inertia of the link", joint, "times", float(prior.inertia)
    return f"centre of mass along {kind[1]}", joint, "m", float(prior.com * centre_size(arm, j))
