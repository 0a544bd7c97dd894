"""Ripple of every gear, found before the search for effects and fitted beside all of them.

Left out, it is more than noise: the drive responds to it, so motion and torque follow it together, which looks like a torque
reading that comes early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.nuisance import Ripple
from calib.diagnosis.rows import Solved
from calib.measurement.ripple_cycles import ripple_cycles, waves
from sim.effects.gear_ripple import GearRipple


def with_gear_ripples(f: Fit) -> Hypothesis:
    """The hypothesis of a fit with each ripple that a joint's residual shows clearly, unless the arm holds one there."""
    start = f.hypothesis.start
    held = [start.effect(GearRipple.name, joint) is not None for joint in start.joint_names]
    return replace(f.hypothesis, ripples=tuple(None if held[j] else _ripple(f.models, f.solved, j) for j in range(start.n)))


def _ripple(models: Sequence[LogModel], solved: Solved, j: int) -> Ripple | None:
    """The strongest ripple of joint j; None if none stands out."""
    rows, at = solved.rows, [m.measurement.row_samples for m in models]
    q = rows.take(j, [m.reading[k, j] for m, k in zip(models, at, strict=True)])
    dq = rows.take(j, [m.measurement.trajectory.dq[k, j] for m, k in zip(models, at, strict=True)])

    def white(cycles: float) -> np.ndarray:
        """(R, 2) white rows of a ripple of unit size."""
        return rows.whiten(solved.noise, j, rows.take(j, [m.rows(waves(cycles, m.reading[:, j])) for m in models]))

    cycles = ripple_cycles(
        solved.left()[j],
        q,
        dq,
        models[0].measurement.decimator,
        lambda k: solved.gain({j: white(k)})[0],
        lambda x: rows.whiten(solved.noise, j, x),
    )
    return None if cycles is None else Ripple(cycles, float(np.hypot(*solved.gain({j: white(cycles)})[1])))
