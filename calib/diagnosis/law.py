"""A friction law of stated terms for what the named effects leave, written into the arm if it predicts left-out recordings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.corrected import ArmChange, correction
from calib.diagnosis.fit import Fit
from calib.diagnosis.model import LogModel
from calib.diagnosis.nuisance import first_own, nuisance_of_joint
from calib.diagnosis.parameters import logarithmic, nominal_values, parameters_of
from calib.diagnosis.sensitivity import columns_of
from calib.passivity import fastest
from calib.regression.friction_fit import FrictionFit, Part, fit_friction
from sim.arm import Arm, ArmEffect
from sim.effects.friction_law import FAMILIES, TERMS, FrictionLaw, formula
from sim.passivity import driving_friction

HELD = 1e-4  # standard deviation of a held parameter, over its prior's
FREE = 10.0  # factor on the prior standard deviation of friction beside a law
SHAPE = 0.5  # relative standard deviation of an effect's shape parameter
# families of terms that are tried together; the linear term is viscous friction, which the fit has anyway
SETS = tuple(
    tuple(TERMS.index(name) for family in families for name in FAMILIES[family] if name != "power_1")
    for families in (("slip",), ("slip", "speed", "stribeck"), ("slip", "speed", "stribeck", "load"))
)
SPEED = {TERMS.index(name) for name in FAMILIES["speed"]}
WITHOUT_SPEED = tuple(tuple(k for k in terms if k not in SPEED) for terms in SETS)


@dataclass(frozen=True)
class Law:
    """The friction law of a joint, and the RMS N m of left-out recordings without and with it."""

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


@dataclass(frozen=True)
class Refitted:
    """A fit written with laws: the correction, its laws, and (n,) N m RMS error of left-out recordings without and with laws.

    For these errors everything is fitted to the other recordings, parameters of named effects included.
    """

    change: ArmChange
    laws: tuple[Law, ...]
    plain: np.ndarray
    predicted: np.ndarray


@dataclass(frozen=True)
class Split:
    """Parts of a fit's recordings that can be left out, and the prior of what is fitted: ordinary parameters, then `named`."""

    parts: list[Part]
    mean: np.ndarray
    precision: np.ndarray
    named: int

    @staticmethod
    def of(written: Fit, pieces: int = 1) -> Split:
        """pieces: number of parts of each recording."""
        named, mean, precision = _names(written)
        parts = [piece for k, m in enumerate(written.models) for piece in _part(m, [c[k] for c in named]).cut(pieces)]
        names = written.models[0].names
        free = [1.0 if name[:2] not in ("Fc", "Fv") else FREE**-2 for name in names]
        return Split(parts, np.concatenate([np.zeros(len(names)), mean]), np.array([*free, *precision]), len(named))


def with_laws(
    written: Fit,
    split: Split,
    only: Sequence[int] = (),
    limits: Sequence[ArmEffect] = (),
    joints: Collection[int] | None = None,
    held: Collection[int] = (),
) -> Refitted:
    """The correction of a fit, with laws at those joints of `only` where left-out parts of the recordings are predicted better.

    The ordinary parameters are fitted again without whitening: a slow residual counts here, as it does for users of the arm.
    Friction may move farther than its prior, because a law takes its place. A law that would drive its joint is left out.
    joints: only their friction and reflected inertia change, and every link stays as it was; None: all change.
    held: joints whose ordinary parameters and link stay as they were.
    """
    names, start = written.models[0].names, written.hypothesis.start
    precision = split.precision.copy()
    precision[[k for k, name in enumerate(names) if name.rpartition("_")[2] in {str(j + 1) for j in held}]] = HELD**-2
    if joints is not None:
        precision[: first_own(start.n)] = precision[names.index("Ia_all")] = HELD**-2
    requested, speeds = list(only), np.fmax(start.dq_max, fastest([m.measurement for m in written.models]))
    while True:
        for sets in (SETS, WITHOUT_SPEED) if requested else ((),):
            found = fit_friction(split.parts, split.mean, np.diag(precision), sets, requested, split.named)
            found = replace(found, theta=found.theta[: len(names)])
            change = _corrected(written, found, limits, joints)
            if not (driven := _driven(start, change, found, speeds)):
                return Refitted(change, _laws(change, found, start), found.plain, found.predicted)
        requested = [j for j in requested if j not in driven]


def _driven(start: Arm, change: ArmChange, found: FrictionFit, speeds: np.ndarray) -> set[int]:
    """Joints that a law drives at some speed up to `speeds` (n,), with more torque than its error.

    Beyond the recorded speeds a fitted curve means nothing, and it must not make a simulation run away.
    """
    before, after = (driving_friction(arm, speeds, found.predicted) for arm in (start, change.of(start)))
    return {start.joint_index(x.joint) for x in after} & set(found.joints) - {start.joint_index(x.joint) for x in before}


def _names(f: Fit) -> tuple[list[list[np.ndarray]], np.ndarray, np.ndarray]:
    """Columns (R, n) per log of the named effects' parameters, and prior mean and precision of their change.

    The prior mean is the absence of the effect, and the distance to it is the standard deviation: recordings that do not show
    an effect do not support it. A shape parameter has no such value and may change by a factor.
    """
    columns, mean, precision = [], [], []
    for (i, p), column in zip(parameters_of(f.accepted), columns_of(f.models, f.hypothesis), strict=True):
        item = f.accepted[i]
        absent, value = nominal_values(f.hypothesis.start, item)[p.name], item.parameters[p.name]
        away = 0.0 if absent is None or logarithmic(p) else value - absent
        spread = abs(away) if away else SHAPE if logarithmic(p) else max(SHAPE * abs(value), 1e-6)
        columns.append(column)
        mean.append(-away)
        precision.append(spread**-2)
    return columns, np.array(mean), np.array(precision)


def _part(m: LogModel, named: Sequence[np.ndarray]) -> Part:
    """All rows in which a joint moves, reversals too, which show how friction builds up; columns of named effects after the ordinary.

    The torque of a joint that stands for longer may be anywhere within its dry friction: it says nothing about the parameters.
    """
    law, moves = FrictionLaw(), m.measurement.row_joint_moving.T
    d = [m.rows(law.terms(m.joint_state(j), 0))[keep] for j, keep in enumerate(moves)]
    x = [np.zeros((keep.sum(), len(m.names) + len(named))) for keep in moves]
    for j, (columns, keep) in enumerate(zip(x, moves, strict=True)):
        columns[:, nuisance_of_joint(m.n, j)] = m.nuisance(j)[keep]
        columns[:, len(m.names) :] = np.column_stack([c[keep, j] for c in named]) if named else 0.0
    return Part(x, d, [m.residual[keep, j] for j, keep in enumerate(moves)])


def _corrected(written: Fit, found: FrictionFit, limits: Sequence[ArmEffect], joints: Collection[int] | None) -> ArmChange:
    """The correction with the ordinary parameters of the fit beside the laws."""
    start = written.hypothesis.start
    theta = np.maximum(found.theta, written.models[0].least)
    change = correction(replace(written, solved=replace(written.solved, theta=theta)), limits, joints)
    return replace(change, effects=(*change.effects, *_effects(start, found)))


def _effects(start: Arm, found: FrictionFit) -> list[ArmEffect]:
    out = []
    for j in found.joints:
        own = start.effect("friction_law", start.joint_names[j])
        terms = {k: float(v) + (own.parameters[k] if own else 0.0) for k, v in zip(TERMS, found.coefficients[j], strict=True)}
        out.append(ArmEffect("friction_law", start.joint_names[j], terms))
    return out


def _laws(change: ArmChange, found: FrictionFit, start: Arm) -> tuple[Law, ...]:
    effects = {e.joint: e for e in change.effects if e.effect == "friction_law"}
    return tuple(Law(effects[start.joint_names[j]], float(found.plain[j]), float(found.predicted[j])) for j in found.joints)
