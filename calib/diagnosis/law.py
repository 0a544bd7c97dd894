"""What the named effects leave, as a friction law of stated terms: written into the arm where it predicts recordings left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.corrected import Correction, correction
from calib.diagnosis.fit import Fit
from calib.diagnosis.model import LogModel
from calib.friction_fit import FrictionFit, Part, fit_friction
from sim.arm import Arm, ArmEffect
from sim.friction_law import FAMILIES, TERMS, FrictionLaw, formula

# which families of terms are tried together; a linear term is viscous friction, which the fit has anyway
FREE = 10.0  # prior standard deviations
SETS = tuple(
    tuple(TERMS.index(name) for family in families for name in FAMILIES[family] if name != "power_1")
    for families in (("slip",), ("slip", "speed", "stribeck"), ("slip", "speed", "stribeck", "load"))
)


@dataclass(frozen=True)
class Law:
    """The friction law of a joint; RMS N m of recordings left out without it and with it."""

    effect: ArmEffect
    without: float
    with_it: float

    def entry(self) -> dict[str, object]:
        """As diagnosis.json has it."""
        return {
            "joint": self.effect.joint,
            "formula": formula(self.effect.parameters),
            "parameters": {k: v for k, v in self.effect.parameters.items() if v},
            "rms_without": self.without,
            "rms_with": self.with_it,
            "unit": "N*m",
        }


def with_laws(written: Fit, only: Sequence[int], limits: Sequence[ArmEffect] = ()) -> tuple[Correction, tuple[Law, ...]]:
    """The correction of a fit, with laws at those joints of `only` where parts of the recordings left out are predicted better.

    The ordinary parameters are fitted again without whitening: what is slow in the residual counts here, as it does for whoever
    uses the arm. Friction may move farther than its prior, because a law takes its place.
    """
    parts, names = [_part(m) for m in written.models], written.models[0].names
    free = [1.0 if name[:2] not in ("Fc", "Fv") else FREE**-2 for name in names]
    found = fit_friction(parts, np.zeros(len(names)), np.diag(free), SETS if only else (), list(only))
    change = _corrected(written, found, limits)
    return change, _laws(change, found, written.hypothesis.start)


def _part(m: LogModel) -> Part:
    """All rows in motion, reversals too, which show how friction builds up."""
    law, keep = FrictionLaw(), m.measurement.row_moving
    d = [m.rows(law.columns(m.joint_state(j), 0))[keep] for j in range(m.n)]
    return Part([m.nuisance(j)[keep] for j in range(m.n)], d, [m.residual[keep, j] for j in range(m.n)])


def _corrected(written: Fit, found: FrictionFit, limits: Sequence[ArmEffect]) -> Correction:
    """The correction whose ordinary parameters are those of the fit beside the laws."""
    start = written.hypothesis.start
    theta = np.maximum(found.theta, written.models[0].least)
    change = correction(replace(written, solved=replace(written.solved, theta=theta)), limits)
    return replace(change, effects=(*change.effects, *_effects(start, found)))


def _effects(start: Arm, found: FrictionFit) -> list[ArmEffect]:
    out = []
    for j in found.joints:
        own = start.effect("friction_law", start.joint_names[j])
        terms = {k: float(v) + (own.parameters[k] if own else 0.0) for k, v in zip(TERMS, found.coefficients[j], strict=True)}
        out.append(ArmEffect("friction_law", start.joint_names[j], terms))
    return out


def _laws(change: Correction, found: FrictionFit, start: Arm) -> tuple[Law, ...]:
    effects = {e.joint: e for e in change.effects if e.effect == "friction_law"}
    return tuple(Law(effects[start.joint_names[j]], float(found.plain[j]), float(found.predicted[j])) for j in found.joints)
