"""What an ordinary refit of the arm's own parameters absorbs: which of them moved, how far, and how certain that is.

A deviation that looks like a heavier link, another friction level or a late reading is no named effect, but it is an answer.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from calib.claims.of_diagnosis import RIPPLE
from calib.diagnosis.corrected import ripples
from calib.diagnosis.fit import Fit
from calib.diagnosis.link_side import centre_size
from calib.diagnosis.nuisance import DELAY_MEAN, DELAY_SPREAD, ROTOR_TOGETHER, spreads
from calib.diagnosis.rows import Solved
from sim.arm import Arm

MOVED, EVIDENT = 1.0, 9.0  # least change in prior standard deviations, and least Wald statistic, to be listed
FRICTION = {
    "Fc": ("Coulomb friction", "coulomb_friction", "coulomb", "N*m"),
    "Fv": ("viscous friction", "viscous_friction", "viscous", "N*m*s/rad"),
    "Ia": ("reflected inertia", "rotor_inertia", "rotor", "kg*m^2"),
    "offset": ("torque offset", "torque_offset", "offset", "N*m"),
}


@dataclass(frozen=True)
class Moved:
    """One parameter of the arm before and after the refit, with its standard deviation, that of its prior, and gap_share.

    gap_share: rise of chi2 if it went back with everything else fixed, as a share of what the whole refit brought. The
    reflected inertia of a joint includes the factor common to all joints, as in the corrected arm.
    """

    name: str
    joint: str | None
    before: float
    after: float
    unit: str
    std: float
    prior_std: float
    gap_share: float

    @property
    def deviations(self) -> float:
        """Change in prior standard deviations."""
        return (self.after - self.before) / self.prior_std

    def entry(self) -> dict[str, object]:
        """As diagnosis.json has it."""
        return {
            "name": self.name, "joint": self.joint, "from": self.before, "to": self.after, "unit": self.unit, "std": self.std,
            "prior_std": self.prior_std, "gap_share": self.gap_share,
        }  # fmt: skip


def calibration(refit: Fit) -> list[Moved]:
    """Parameters that moved significantly and by at least MOVED, farthest first; every gear's ripple is among them."""
    arm, solved = refit.hypothesis.start, refit.solved
    names, brought, out = refit.models[0].names, _brought(solved), []
    for k, name in enumerate(names):
        if (found := _meaning(arm, name)) is None or found[-1] == 0.0:
            continue
        what, joint, value, unit, size = found
        per = np.zeros(len(solved.theta))
        per[k] = size
        if name.startswith("Ia_"):
            per[names.index("Ia_all")] = ROTOR_TOGETHER * value
        moved, variance = float(per @ solved.theta), max(float(per @ solved.inverse @ per), 1e-12 * size**2)
        if abs(moved) >= MOVED * size and moved**2 >= EVIDENT * variance:
            share = min(1.0, moved**2 / variance / max(brought, 1e-12))
            out.append(Moved(what, joint, value, value + moved, unit, float(np.sqrt(variance)), size, share))
    for e in ripples(refit):
        size, std = e.parameters["amplitude"], e.std["amplitude"]
        what = f"{RIPPLE} of {e.parameters['cycles']:.0f} cycles a turn"
        out.append(Moved(what, e.joint, 0.0, size, "N*m", std, size, min(1.0, (size / std) ** 2 / max(brought, 1e-12))))
    return sorted(out, key=lambda x: -abs(x.deviations))


def _brought(solved: Solved) -> float:
    """Fall of chi2 by the whole refit."""
    fall = 0.0
    for j, (r, left) in enumerate(zip(solved.rows.r, solved.left(), strict=True)):
        fall += float(np.sum(solved.rows.whiten(solved.noise, j, r) ** 2) - np.sum(left**2))
    return fall


def _meaning(arm: Arm, name: str) -> tuple[str, str | None, float, str, float] | None:
    """Name, joint, nominal value, unit and prior standard deviation of a nuisance parameter; None if it is not listed."""
    if name == "delay":
        return "delay of the torque reading", None, 1e3 * DELAY_MEAN, "ms", 1e3 * DELAY_SPREAD
    match = re.fullmatch(r"(m|cx|cy|cz|I|Fc|Fv|Ia|offset)_(\d+)", name)
    if match is None:
        return None
    kind, j = match[1], int(match[2]) - 1
    joint, prior = arm.joint_names[j], arm.prior
    if kind in FRICTION:
        what, effect, key, unit = FRICTION[kind]
        own = arm.effect(effect, joint)
        return what, joint, next(iter(own.parameters.values())) if own else 0.0, unit, float(spreads(arm)[key][j])
    if kind == "m":
        return "mass of the link", joint, float(arm.tree.mass[j]), "kg", float(prior.mass * arm.tree.mass[j])
    if kind == "I":
        return "inertia of the link", joint, 1.0, "times", float(prior.inertia)
    return (
        f"centre of mass along {kind[1]}",
        joint,
        float(arm.tree.com[j]["xyz".index(kind[1])]),
        "m",
        float(prior.com * centre_size(arm, j)),
    )
