"""Whether the model still fits the arm: the unexplained torque, against the torque itself and against its level at the start.

Readings that the model never fits show nothing about the arm: they are of another arm, or the model was never this arm's.
"""

from __future__ import annotations

import numpy as np

from calib.watch.events import Kind, Quantity, WatchEvent
from calib.watch.filter import TorqueFilter
from calib.watch.momentum import Row
from sim.arm import Arm

FIRST = 4.0  # s of motion after which the first verdict is given
UNFIT = 0.35  # share of the variation of a loaded joint's torque that may stay unexplained at first
STRAYS = 0.6  # share of dry friction that may stay unexplained at first: friction is what varies from arm to arm
HELD = 0.8  # the same for a joint whose torque hardly varies: what it holds may be as large as its friction
REFERENCE = 20.0  # s of motion that give the residual of a healthy arm
RECENT = 8.0  # s of motion over which the residual is compared with it
TIMES_WORSE = 3.0  # of the reference residual
HOLDS = 4.0


class ValidityWatch:
    """Rows in, events out; `fits` is None until the first verdict, and no claim is made where it is not True."""

    def __init__(self, arm: Arm, filter_: TorqueFilter) -> None:
        self._arm, self._filter = arm, filter_
        n = arm.n
        self.fits: bool | None = None
        self._seconds = np.zeros(n)
        self._sums = np.zeros((3, n))
        self._reference = np.full(n, np.nan)
        self._recent = np.zeros(n)
        self._worse = np.zeros(n)
        self._reported = False
        # s: since when each joint's residual is compared with that of its first REFERENCE s
        self.compared_from = np.full(n, np.nan)

    @property
    def residual(self) -> np.ndarray:
        """(n,) N m RMS residual over all rows, NaN for a joint that never moved."""
        return np.sqrt(self._sums[2] / np.where(self._seconds > 0, self._seconds, np.nan))

    @property
    def seconds(self) -> np.ndarray:
        """(n,) s of informative motion."""
        return self._seconds

    def add(self, row: Row, settled: bool) -> list[WatchEvent]:
        """Take a row of an arm without contact; `settled` once the payload is known."""
        used = self._filter.usable(row)
        left = self._filter.left(row, self._filter.x)
        if not settled:
            return []
        self._seconds += used * row.seconds
        self._sums += row.seconds * np.where(used, np.stack([row.torque, row.torque**2, left**2]), 0.0)
        if self.fits is None:
            return self._first(row)
        gain = np.minimum(row.seconds / RECENT, 1.0) * used
        self._recent = np.where(self._recent > 0, self._recent + gain * (left**2 - self._recent), np.where(used, left**2, 0.0))
        learnt = np.isnan(self._reference) & (self._seconds > REFERENCE)
        self._reference[learnt], self.compared_from[learnt] = self.residual[learnt], row.t
        return self._against_reference(row, used)

    def _first(self, row: Row) -> list[WatchEvent]:
        known = self._seconds > 0.5 * FIRST
        if self._seconds.max() < FIRST or known.sum() < min(2, self._arm.n):
            return []
        mean, square, left = self._sums[:, known] / self._seconds[known]
        variation = np.sqrt(np.maximum(square - mean**2, 0.0))
        # joints that carry little load show little: their torque is nearly all friction
        dry = self._filter.dry[known]
        loaded = np.sqrt(left) > np.where(variation > 0.5 * dry, STRAYS, HELD) * dry
        share = np.sqrt(left) / np.maximum(variation, 1e-12)
        mass = self._filter.x[0]
        impossible = mass < -5 * np.sqrt(self._filter.covariance[0, 0]) - 0.1 * self._filter.mass_scale
        heavy = abs(mass) > 5 * self._filter.mass_scale
        self.fits = not (float(share.max(initial=0.0, where=loaded)) > UNFIT or impossible or heavy)
        if self.fits:
            return []
        j = int(np.flatnonzero(known)[np.argmax(np.where(loaded, share, 0.0))])
        most = float(np.sqrt(left[np.flatnonzero(known) == j][0]))
        against = (
            f"{most / self._filter.dry[j]:.0%} of its dry friction" if self._filter.states_dry[j] else "for which the model states no coulomb_friction"
        )  # fmt: skip
        detail = (
            f"a load of {mass:.3g} kg would be needed to explain them" if impossible or heavy
            else f"{most:.2g} N m stay unexplained at {self._arm.joint_names[j]}, {against}"
        )  # fmt: skip
        text = (
            f"these readings do not fit {self._arm.name}: {detail}; another arm, another mounting, or a model that was never this "
            "arm's: no claim about the arm is made. Name the right arm, or calibrate it first"
        )
        return [WatchEvent(Kind.WRONG_ARM, row.t, (row.t - FIRST, row.t), text)]

    def _against_reference(self, row: Row, used: np.ndarray) -> list[WatchEvent]:
        worse = self._recent > TIMES_WORSE**2 * np.where(np.isfinite(self._reference), self._reference, np.inf) ** 2
        self._worse = np.where(worse, self._worse + row.seconds * used, 0.0)
        if self._reported or not np.any(self._worse > HOLDS):
            self._reported = self._reported and bool(worse.any())
            return []
        self._reported = True
        j = int(np.argmax(self._worse))
        now = Quantity(float(np.sqrt(self._recent[j])), float(self._filter.noise[j]) / np.sqrt(RECENT), "N*m")
        joint = self._arm.joint_names[j]
        text = (
            f"the residual of {joint} is {now.value:.3g} N m, {now.value / self._reference[j]:.1f} times as large as at the start: the "
            "model no longer fits this arm; record a log and run calib diagnose"
        )
        return [WatchEvent(Kind.MODEL_INVALID, row.t, (row.t - HOLDS, row.t), text, {"residual": now}, joint)]
