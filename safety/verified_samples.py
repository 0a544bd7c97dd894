"""The verified motions of a stage, as the monitor process reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from safety.monitor import Expected
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop


class VerifiedSamples:
    """The verified motions of one stage, mapped read-only from a file that is then unlinked, so that nobody else can open it.

    SafetyStop if a number is not finite, if a motion leaves the arm's range or speed limit, or if it has less room than the
    cell requires.
    """

    def __init__(self, file: Path, counts: Sequence[int], arm: Arm, cell: Cell, rate: float) -> None:
        self._rows = np.asarray(np.load(file, mmap_mode="r"))  # a plain array: a slice of a memmap costs ten times as much
        file.unlink()
        self._begins: list[int] = [0, *np.cumsum(counts).tolist()]
        n, rows = arm.n, self._rows
        if not (rows.ndim == 2 and rows.shape == (self._begins[-1], 5 * n + 1) and np.isfinite(rows).all()):
            raise SafetyStop(f"monitor process: {rows.shape} verified samples, not {self._begins[-1]} of finite numbers")
        self._n, motion = n, cell.table.motion
        q, room = rows[:, :n], rows[:, 5 * n]
        fast = [np.abs(np.diff(q[a:b], axis=0)) * rate <= arm.dq_max * (1 + 1e-6) for a, b in self._legs()]
        inside = (q >= arm.q_min).all() and (q <= arm.q_max).all() and all(f.all() for f in fast)
        if not (inside and (room >= motion.following_error * (1 - 1e-9)).all()):
            raise SafetyStop(
                "monitor process: a verified motion exceeds the arm's range or speed, or has less room than the cell requires"
            )

    def _legs(self) -> list[tuple[int, int]]:
        return list(zip(self._begins[:-1], self._begins[1:], strict=True))

    def last(self, leg: int) -> list[np.ndarray]:
        """The last command (n,) rad of a leg, in a list; an empty list if there is no such leg."""
        return [self._rows[self._begins[leg + 1] - 1, : self._n]] if 0 <= leg < len(self._begins) - 1 else []

    def sample(self, leg: int, k: int) -> tuple[np.ndarray, Expected] | None:
        """The command (n,) rad of sample k of a leg, and what is expected there; None if there is no such sample."""
        if not (0 <= leg < len(self._begins) - 1 and 0 <= k < self._begins[leg + 1] - self._begins[leg]):
            return None
        row, n = self._rows[self._begins[leg] + k], self._n
        tau_hat, doubt, sudden, load = row[n : 2 * n], row[2 * n : 3 * n], row[3 * n : 4 * n], row[4 * n : 5 * n]
        return row[:n], Expected(tau_hat, doubt, sudden, float(row[5 * n]), load)
