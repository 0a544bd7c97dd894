"""Since when an arm has had its effects: those that the newest recordings show are looked for in the older ones.

Along a log, e = tau_hat(arm with the effect) - tau_hat(arm without it). The amplitude a = <r, e>/<e, e> of the residual r without it is
about 1 where the effect was present at its current size, and about 0 where it was absent. Rows are weighted by each joint's own residual.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.measurement.preprocessing import Measurement, prepare
from logs import Log
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.prediction import predict

PRESENT = 0.5
SHORTEST_ROWS = 40


@dataclass(frozen=True)
class History:
    """An effect's amplitude in recordings, oldest first: (when, amplitude); NaN where the motion does not show it.

    since: the earliest instant from which every recording that can show the effect does.
    """

    effect: str
    joint: str | None
    amplitudes: tuple[tuple[str, float], ...]

    @property
    def since(self) -> str:
        first = ""
        for when, amplitude in reversed(self.amplitudes):
            if np.isnan(amplitude):
                continue
            if amplitude < PRESENT:
                break
            first = when
        return first

    @property
    def began(self) -> bool:
        """Whether an older recording shows that the effect was not always there."""
        return any(amplitude < PRESENT for _, amplitude in self.amplitudes)


def histories(arm: Arm, found: Sequence[ArmEffect], recordings: Iterable[tuple[str, Log]]) -> list[History]:
    """The amplitude of every effect in each of the recordings (when, log), oldest first."""
    whole = arm
    for item in found:
        whole = with_effect(whole, item)
    rest = [_without(arm, found, item) for item in found]
    amplitudes: list[list[tuple[str, float]]] = [[] for _ in found]
    for when, log in recordings:
        m = prepare(log, arm)
        full = predict(whole, m.trajectory)
        for k, other in enumerate(rest):
            amplitudes[k].append((when, amplitude(m, predict(other, m.trajectory), full)))
    return [History(e.effect, e.joint, tuple(a)) for e, a in zip(found, amplitudes, strict=True)]


def amplitude(m: Measurement, without: np.ndarray, whole: np.ndarray) -> float:
    """a = <r, e>/<e, e> over usable rows; without and whole (N, n) N m are predictions. NaN where e is lost in the residual."""
    usable = m.row_usable
    r, e = m.rows(m.tau - without), m.rows(whole - without)
    product = square = 0.0
    for j in range(m.n):
        keep = usable[:, j]
        if keep.sum() < SHORTEST_ROWS:
            continue
        left = r[keep, j] - e[keep, j]
        variance = max(min(float(np.mean(left**2)), float(np.mean(r[keep, j] ** 2))), 1e-12)
        product += float(r[keep, j] @ e[keep, j]) / variance
        square += float(e[keep, j] @ e[keep, j]) / variance
    return product / square if square > 1.0 else float("nan")


def _without(arm: Arm, found: Sequence[ArmEffect], item: ArmEffect) -> Arm:
    for other in found:
        if other is not item:
            arm = with_effect(arm, other)
    return arm
