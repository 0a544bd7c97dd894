"""Columns of a joint's torque: the arm's parameters, the terms of its friction law, and the measured torque."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib.identification.model import TorqueModel
from calib.measurement.preprocessing import Measurement
from calib.regression.friction_fit import Part
from sim.effects.friction_law import FAMILIES, TERMS, WIDTHS, FrictionLaw
from sim.prediction import by_stage, link_side, motor_side

SLIP = tuple(TERMS.index(name) for name in FAMILIES["slip"])


def nearest_width(width: float) -> int:
    """Index of the law's width that is nearest to `width`, rad, on a logarithmic scale."""
    return int(np.argmin(np.abs(np.log(np.array(WIDTHS) / width))))


def part_of(model: TorqueModel, m: Measurement, sigma: np.ndarray | None = None) -> Part:
    """Rows between the first and the last motion, including reversals.

    Joints that stand are included. Without them the reading of speed was chosen differently for a UR10e, and of 36 changes made to it
    two more were named beside what had changed.

    sigma (n,) N m: noise of the rows; with it, rows over bridged gaps weigh less.
    """
    x, d, r = [], [], []
    for j, columns in enumerate(_columns(model, m)):
        rows = m.rows(columns)[m.row_moving]
        if sigma is not None and m.doubt is not None:
            rows = rows / np.sqrt(1 + m.row_doubt[m.row_moving, j] / sigma[j] ** 2)[:, None]
        x.append(rows[:, : model.p])
        d.append(rows[:, model.p : -1])
        r.append(rows[:, -1])
    return Part(x, d, r)


def products_of(model: TorqueModel, measurements: Sequence[Measurement]) -> list[np.ndarray]:
    """Per joint (p + k + 1, p + k + 1): products of the columns over the samples in motion, before any filter.

    Keeping the samples themselves would take a gigabyte of memory for ten minutes.
    """
    size = model.p + len(TERMS) + 1
    out = [np.zeros((size, size)) for _ in range(model.arm.n)]
    for m in measurements:
        for total, columns in zip(out, _columns(model, m), strict=True):
            moving = columns[m.samples_moving]
            used = np.flatnonzero(moving.any(axis=0))
            total[np.ix_(used, used)] += moving[:, used].T @ moving[:, used]
    return out


def _columns(model: TorqueModel, m: Measurement) -> Iterator[np.ndarray]:
    """Per joint (N, p + k + 1): columns of theta, of the friction law's terms, and the torque."""
    arm, law, tr = model.arm, FrictionLaw(), m.trajectory
    nothing = by_stage((), arm)
    state = link_side(arm, tr, nothing)
    motor_side(state, nothing)
    links = model.joint_columns(tr.q, tr.dq, tr.ddq)
    for j in range(arm.n):
        terms = law.terms(state, j)
        own = np.zeros((len(tr.t), model.p))
        own[:, model.used_by(j)] = links[j]
        # dry friction as a prediction builds it up, also between samples
        own[:, model.friction_column("coulomb", j)] = terms[:, SLIP[nearest_width(model.slip_width[j])]]
        yield np.column_stack([own, terms, m.tau[:, j]])
