"""Simulated motion of changed arms: a change is not written if it moves farther from the recording than the arm as it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.significance import SIGNIFICANT
from calib.measurement.preprocessing import Measurement
from calib.validation.forward import HORIZONS, ForwardError, forward_error
from sim.arm import Arm
from sim.errors import ConfigError

FARTHER = 0.05  # share by which the simulated flange (or angle, of a bench drive) may be farther from the recorded one
ENOUGH = 4  # windows, or parts of one
FEW = tuple(replace(h, windows=w) for h, w in zip(HORIZONS, (12, 5, 1), strict=True))


class SimulatedMotion:
    """Forward-simulation errors of changed arms and `start`, on the first recording in which every joint moves long enough."""

    def __init__(self, start: Arm, shown: Sequence[Measurement]) -> None:
        self.start, self.shown = start, shown
        self._known: dict[int, tuple[ArmChange, tuple[ForwardError, ...]]] = {}

    @cached_property
    def _before(self) -> tuple[Measurement, tuple[ForwardError, ...]]:
        for m in self.shown:
            errors = _errors(self.start, m, self.start)
            if errors[0].starts:
                break
        return m, errors

    def errors(self, change: ArmChange) -> tuple[tuple[ForwardError, ForwardError], ...]:
        """(before, after) for every horizon that has windows on that recording."""
        recording, before = self._before
        if id(change) not in self._known:
            self._known[id(change)] = change, self._of(change, recording)
        return tuple((a, b) for a, b in zip(before, self._known[id(change)][1], strict=True) if a.starts)

    def rises(self, change: ArmChange, than: ArmChange | None = None) -> bool:
        """Whether over any horizon the motion is farther off, by more than FARTHER and significantly over the windows.

        than: another change, with which it is compared; None: the arm as it was.
        """
        other = [a if than is None else b for a, b in self.errors(than or change)]
        return any(_farther(a, b) for a, (_, b) in zip(other, self.errors(change), strict=True))

    def worst(self, change: ArmChange) -> tuple[ForwardError, ForwardError]:
        """The error before and after, over the horizon at which it grows most."""
        stable = [pair for pair in self.errors(change) if 0.0 < pair[0].compared < np.inf]
        return max(stable, key=lambda pair: pair[1].compared / pair[0].compared)

    def _of(self, change: ArmChange, m: Measurement) -> tuple[ForwardError, ...]:
        try:
            return _errors(change.of(self.start), m, self.start)
        except ConfigError:  # not physically consistent
            endless = np.full(self.start.n, np.inf)
            return tuple(ForwardError(h, endless, np.inf, endless, (0,), np.full(ENOUGH, np.inf)) for h in FEW)


def _errors(arm: Arm, m: Measurement, start: Arm) -> tuple[ForwardError, ...]:
    return tuple(forward_error(arm, m, horizon, start) for horizon in FEW)


def _farther(a: ForwardError, b: ForwardError) -> bool:
    if not 0.0 < a.compared < np.inf:
        return False  # unstable already
    if not np.isfinite(b.compared):
        return True
    if len(a.squares) < ENOUGH:
        return False
    more = b.squares - (1 + FARTHER) ** 2 * a.squares
    return bool(more.mean() > SIGNIFICANT * more.std(ddof=1) / np.sqrt(len(more)))
