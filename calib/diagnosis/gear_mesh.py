"""The ripple of a gear's mesh: a sine along a joint's angle with dozens to hundreds of cycles in a turn, which every gear has.

It is one of the uncertain numbers beside every effect. Left out, it does more than add noise: the drive answers it, so the motion and the
torque follow it together, and that looks like a torque reading which comes early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import freqz

from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.nuisance import GearMesh, ripple
from calib.diagnosis.rows import Solved
from sim.effects.gear_ripple import FEWEST

# cycles in a turn; faster ripple is beyond the filter at any speed that shows friction
MOST = 260.0
# Fall of -2 log likelihood from which a ripple is fitted. Noise alone reaches 30 at one joint of ten thousand: some 300 numbers of cycles are
# tried, each passes with exp(-15). A missing effect leaves something at every number of cycles: a ripple stands so many times over their
# median (on the real UR10e 19 to 320 times).
LEAST_GAIN, OVER_MEDIAN = 30.0, 6.0
# The scan's step: at most so many cycles, and this share of what the whole range of motion turns once (a peak is 2 pi over the range wide).
COARSEST, OF_WIDTH = 2.0, 1.5
# the scan neglects changes of speed: what it finds is worth an exact look from this share of the least gain on, at these parts of a step
SCANNED, NEAR = 0.5, (-0.6, -0.3, 0.0, 0.3, 0.6)
CHUNK = 64  # numbers of cycles at a time, for memory


def with_gear_mesh(f: Fit) -> Hypothesis:
    """The hypothesis of a fit with the mesh of each joint whose residual shows one clearly."""
    return replace(f.hypothesis, mesh=tuple(_mesh(f.models, f.solved, j) for j in range(f.hypothesis.arm.n)))


def _mesh(models: Sequence[LogModel], solved: Solved, j: int) -> GearMesh | None:
    """The strongest ripple of joint j, None where none stands out."""
    rows = solved.rows
    if not len(rows.r[j]):
        return None
    at = [m.measurement.row_samples for m in models]
    q = rows.take(j, [m.reading[k, j] for m, k in zip(models, at, strict=True)])
    dq = rows.take(j, [m.measurement.trajectory.dq[k, j] for m, k in zip(models, at, strict=True)])
    span = float(np.ptp(q))
    if span * FEWEST < 2 * np.pi:
        return None
    step = min(COARSEST, OF_WIDTH / span)
    cycles = np.arange(FEWEST, MOST, step)
    gains = np.concatenate([_scanned(solved, j, models[0], q, dq, cycles[k : k + CHUNK]) for k in range(0, len(cycles), CHUNK)])
    least, best = max(LEAST_GAIN, OVER_MEDIAN * float(np.median(gains))), float(cycles[np.argmax(gains)])
    if gains.max() < SCANNED * least:
        return None
    gain, mesh = max((_gained(models, solved, j, best + d * step) for d in NEAR), key=lambda x: x[0])
    return mesh if gain > least else None


def _scanned(solved: Solved, j: int, model: LogModel, q: np.ndarray, dq: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """(K,) about what a ripple of each number of cycles brings, at row angles q and speeds dq (R,): as if the speed stayed over the filter."""
    decimator = model.measurement.decimator
    rate, response = freqz(decimator.taps, worN=512, fs=decimator.rate)
    passed = np.interp(np.abs(dq)[:, None] * cycles / (2 * np.pi), rate, np.abs(response))
    left, phase, out = solved.left()[j], q[:, None] * cycles, np.zeros(len(cycles))
    for of in (np.sin, np.cos):
        wave = solved.rows.whiten(solved.noise, j, passed * of(phase))
        out += (left @ wave) ** 2 / np.maximum((wave**2).sum(axis=0), 1e-9)
    return out


def _gained(models: Sequence[LogModel], solved: Solved, j: int, cycles: float) -> tuple[float, GearMesh]:
    """Fall of -2 log likelihood by a ripple beside the other uncertain numbers, and the ripple."""
    unit = GearMesh(cycles, 1.0)
    waves = [m.rows(ripple(unit, m.reading[:, j])) for m in models]
    gain, c, _ = solved.gain({j: solved.rows.whiten(solved.noise, j, solved.rows.take(j, waves))})
    return gain, GearMesh(cycles, float(np.hypot(*c)))
