"""What may be written into the corrected arm: only names and laws with which the arm, as it is written, predicts better.

The arm is judged as anyone would use it (sim.prediction.predict, every row in motion, reversals too), because a fit can lean on
numbers that an arm folder does not hold. It is compared with the arm as it was, and with the arm that has friction laws and no names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.corrected import Correction, correction, names_alone
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.law import Law, with_laws
from calib.diagnosis.model import CONTACT
from calib.diagnosis.selection import joints_of
from calib.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.prediction import predict

# relative rise of a joint's RMS torque error within which two arms are alike, and that a name may cost beside a law that bends to anything
WORSE, WORSE_THAN_LAW = 0.01, 0.05
WORSE_ELSEWHERE = 0.05  # at a joint that no name concerns, where a refit moves ordinary parameters


@dataclass(frozen=True)
class Refusal:
    """A name that was fitted and not kept: joint where the error rose, RMS N m without and with it, on which recordings."""

    effect: ArmEffect
    joint: str
    without: float
    with_it: float
    on: str

    @property
    def text(self) -> str:
        """What was tried and why it was refused."""
        where = f" at {self.effect.joint}" if self.effect.joint else ""
        return (
            f"{self.effect.effect}{where} was fitted and is left out of the corrected arm: on the {self.on} recordings the torque "
            f"error of {self.joint} is {self.with_it:.4g} N m with it and {self.without:.4g} N m without it"
        )


@dataclass(frozen=True)
class Promotion:
    """change: of the arm that is written, None where the arm stays as it was; laws in it; names that it does not hold, and why."""

    change: Correction | None
    laws: tuple[Law, ...]
    refused: tuple[Refusal, ...]


def promoted(
    measurements: Sequence[Measurement],
    named: Fit,
    baseline: Fit,
    apart: Sequence[Measurement],
    limits: Sequence[ArmEffect] = (),
) -> Promotion:
    """The arm with the names of `named`, refitted with what an arm folder can hold, and friction laws of what they leave.

    Names at a joint whose error is higher than without any name are left out, and the rest is refitted. The errors are of the
    recordings kept apart; without any, of those that were fitted, which refuses less.
    """
    start, shown, on = baseline.hypothesis.start, apart or measurements, "held-out" if apart else "fitted"
    bare = torque_rms(start, shown)
    plain = _ways(as_written(measurements, baseline), shown, limits)[0]
    most = np.minimum((1 + WORSE) * bare, (1 + WORSE_THAN_LAW) * plain.rms)
    f = as_written(measurements, named)
    refused: list[Refusal] = []
    while True:  # every round leaves out at least one name
        own = [e for e in f.accepted if e.effect != CONTACT]
        if not own:
            break
        concerned = {j for e in own for j in joints_of(e, f.hypothesis.arm)}
        limit = np.array([most[j] if j in concerned else (1 + WORSE_ELSEWHERE) * bare[j] for j in range(start.n)])
        ways = _ways(f, shown, limits)
        good = next((way for way in ways if np.all(way.rms <= limit)), None)
        if good is not None:
            return Promotion(good.change, good.laws, tuple(refused))
        found = ways[0]
        worse = {j for j in range(start.n) if found.rms[j] > limit[j]}
        harmful = [e for e in own if set(joints_of(e, f.hypothesis.arm)) & worse] or own
        for e in harmful:
            j = max(set(joints_of(e, f.hypothesis.arm)) & worse or worse, key=lambda j: found.rms[j] / limit[j])
            without = float(min(bare[j], plain.rms[j]))
            refused.append(Refusal(e, start.joint_names[j], without, float(found.rms[j]), on))
        rest = tuple(e for e in f.accepted if e not in harmful)
        event = f.hypothesis.event_log if any(e.effect == CONTACT for e in rest) else None
        f = fit(measurements, f.hypothesis.with_effects(rest, event), 3, f.solved.noise, f.models)
    if (plain.laws or limits) and np.all(plain.rms <= (1 + WORSE) * bare):
        return Promotion(plain.change, plain.laws, tuple(refused))
    return Promotion(Correction({}, tuple(limits)) if limits else None, (), tuple(refused))


@dataclass(frozen=True)
class _Written:
    change: Correction
    laws: tuple[Law, ...]
    rms: np.ndarray

    @staticmethod
    def of(change: Correction, laws: tuple[Law, ...], start: Arm, shown: Sequence[Measurement]) -> _Written:
        return _Written(change, laws, torque_rms(change.of(start), shown))


def _ways(f: Fit, shown: Sequence[Measurement], limits: Sequence[ArmEffect]) -> list[_Written]:
    """A fit as an arm in several ways, the one that predicts the recordings `shown` best first.

    Tried are the names alone, the refit under the measured noise, the refit without whitening, and that with laws where they help.
    """
    start = f.hypothesis.start
    plain, _ = with_laws(f, (), limits)
    ways = [_Written.of(x, (), start, shown) for x in (names_alone(f, limits), correction(f, limits), plain)]
    rms = ways[-1].rms
    only: Sequence[int] = range(start.n)
    while only:
        more, laws = with_laws(f, only, limits)
        if not laws:
            break
        found = _Written.of(more, laws, start, shown)
        spoilt = [j for j in range(start.n) if found.rms[j] > (1 + WORSE) * rms[j]]
        if not spoilt:
            ways.append(found)
            break
        have = [start.joint_index(str(x.effect.joint)) for x in laws]
        only = [j for j in have if j not in spoilt] if set(have) & set(spoilt) else []
    return sorted(ways, key=lambda way: float(np.sum(np.log(np.maximum(way.rms, 1e-12)))))


def as_written(measurements: Sequence[Measurement], named: Fit) -> Fit:
    """The fit of what an arm folder can hold."""
    if named.hypothesis.written:
        return named
    return fit(measurements, named.hypothesis.as_written(), 3, named.solved.noise, named.models)


def torque_rms(arm: Arm, measurements: Sequence[Measurement]) -> np.ndarray:
    """(n,) N m RMS torque error of an arm between the first and the last motion, filtered as the fit's rows are."""
    squares, count = np.zeros(arm.n), 0
    for m in measurements:
        error = m.rows(m.tau - predict(arm, m.trajectory))[m.row_moving]
        squares += np.sum(error**2, axis=0)
        count += len(error)
    return np.sqrt(squares / max(count, 1))
