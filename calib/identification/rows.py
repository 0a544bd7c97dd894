"""A_j theta = b_j: filtered rows of every joint, kept in memory if few, recomputed block by block if many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.identification.model import TorqueModel
from calib.measurement.preprocessing import Measurement
from calib.regression.noise import depth, neighbours

KEPT_BYTES = 300_000_000
# Rows after a stop, a reversal or a gap that only serve to filter the next ones to white noise: friction is still building up.
# Fitting them raises the error on a held-out log from 0.39 to 0.59 of the torque std on a real servo (XL330), and changes
# nothing on six real arms.
SETTLED = 4


@dataclass(frozen=True)
class Block:
    """Neighbouring rows of one log.

    a       per joint (R, p_j), the columns `used[j]` only
    b       (R, n) N m
    usable  (R, n) rows of the fit; apart (R, n) usable rows that are left out of it
    doubt   (R, n) (N m)^2 that bridged gaps add to the variance of b
    joined  (R,) False where the row before is not the neighbour in time
    t       (R,) s
    """

    log: int
    a: list[np.ndarray]
    b: np.ndarray
    usable: np.ndarray
    apart: np.ndarray
    doubt: np.ndarray
    joined: np.ndarray
    t: np.ndarray

    def of_joint(self, j: int) -> JointRows:
        """Rows that the fit of joint j uses; a block's first row has no neighbour."""
        index = np.flatnonzero(self.usable[:, j])
        joined = neighbours(index, np.cumsum(~self.joined)[index])
        return JointRows(
            self.a[j][index], self.b[index, j], joined, self.doubt[index, j], index, depth(joined, SETTLED) == SETTLED
        )


@dataclass(frozen=True)
class JointRows:
    """Rows of one joint.

    a (R, p_j), b (R,) N m; joined (R,) whether the previous row is the neighbour in time; doubt (R,) (N m)^2
    index (R,) in the block; settled (R,) whether SETTLED usable rows lie before it without a break
    """

    a: np.ndarray
    b: np.ndarray
    joined: np.ndarray
    doubt: np.ndarray
    index: np.ndarray
    settled: np.ndarray


@dataclass
class RegressorRows:
    """The rows of several measurements under one model; iterate as often as needed.

    leave_out: measurement index -> (R, n) mask of further rows to leave out, such as sweeps that a pre-estimate has used.
    """

    model: TorqueModel
    measurements: Sequence[Measurement]
    leave_out: dict[int, np.ndarray] = field(default_factory=dict)
    progress: Callable[[float], None] | None = None
    used: list[np.ndarray] = field(init=False)
    _kept: list[Block] | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.used = [self.model.used_by(j) for j in range(self.model.arm.n)]

    @property
    def row_rate(self) -> float:
        """Rows per second."""
        return self.measurements[0].decimator.row_rate

    def part(self, k: int) -> RegressorRows:
        """The rows of measurement k alone."""
        left = {0: self.leave_out[k]} if k in self.leave_out else {}
        out = RegressorRows(self.model, [self.measurements[k]], left)
        out._kept = None if self._kept is None else [b for b in self._kept if b.log == k]
        return out

    def __iter__(self) -> Iterator[Block]:
        if self._kept is not None:
            yield from self._kept
            return
        size = sum(len(m.row_samples) for m in self.measurements) * 8 * sum(len(u) for u in self.used)
        kept: list[Block] | None = [] if size <= KEPT_BYTES else None
        for block in self._computed():
            if kept is not None:
                kept.append(block)
            yield block
        self._kept = kept

    def _computed(self) -> Iterator[Block]:
        total = sum(len(m.row_samples) for m in self.measurements)
        done = 0
        for k, m in enumerate(self.measurements):
            first = 0
            previous = -1
            left = self.leave_out.get(k, np.zeros_like(m.row_usable)) & m.row_usable
            allowed = m.row_usable & ~left
            for samples in m.blocks(20_000):
                tr = m.trajectory
                fine = self.model.joint_columns(tr.q[samples], tr.dq[samples], tr.ddq[samples])
                a = [m.decimator.rows(x) for x in fine]
                b = m.decimator.rows(m.tau[samples])
                rows = slice(first, first + len(b))
                stretch = m.row_stretch[rows]
                joined = np.concatenate([[stretch[0] == previous], np.diff(stretch) == 0])
                yield Block(k, a, b, allowed[rows], left[rows], m.row_doubt[rows], joined, tr.t[m.row_samples[rows]])
                previous, first = int(stretch[-1]), rows.stop
                done += len(b)
                if self.progress:
                    self.progress(done / total)
