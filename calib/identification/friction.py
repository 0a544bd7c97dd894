"""tau_j = viscous dq + coulomb s + offset + A cos q + B sin q: friction of one joint from sweeps at constant speed.

With every other joint at rest, gravity on joint j is exactly A cos q_j + B sin q_j, whatever the masses of the links. The
estimate is therefore independent of the model of the links and can serve as its prior.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from calib.identification.model import FRICTION, TorqueModel
from calib.measurement.preprocessing import Measurement
from calib.regression.normal_equations import Prior, inverse

SHORTEST_SECONDS = 0.4


@dataclass(frozen=True)
class Sweep:
    """Friction of one joint: mean (3,) and covariance (3, 3) of viscous N m s/rad, coulomb N m, offset N m."""

    joint: int
    mean: np.ndarray
    covariance: np.ndarray


def sweep_rows(m: Measurement) -> np.ndarray:
    """(R, n) rows in which a joint moves at constant speed for SHORTEST_SECONDS or longer while every other joint stands."""
    dq, ddq = m.rows(m.trajectory.dq), m.rows(m.trajectory.ddq)
    fastest = np.maximum(np.abs(dq).max(axis=0), 1e-9)
    still = np.abs(dq) < 0.004 * fastest.max()
    out = np.zeros_like(m.row_usable)
    shortest = max(3, int(SHORTEST_SECONDS * m.decimator.row_rate))
    for j in range(m.n):
        others = np.delete(still, j, axis=1).all(axis=1)
        steady = others & ~still[:, j] & (np.abs(ddq[:, j]) * 0.3 < 0.1 * np.abs(dq[:, j])) & m.row_usable[:, j]
        edge = np.unique(np.concatenate([[0], np.flatnonzero(np.diff(steady)) + 1, [len(steady)]]))
        for lo, hi in itertools.pairwise(edge):
            out[lo:hi, j] = steady[lo] and hi - lo >= shortest
    return out


def pre_estimate(measurements: list[Measurement], model: TorqueModel) -> tuple[list[Sweep], dict[int, np.ndarray]]:
    """Sweeps of every joint swept in both directions at two speeds or more, and per measurement the rows (R, n) used."""
    masks = [sweep_rows(m) for m in measurements]
    sweeps = []
    for j in range(model.arm.n):
        parts = [_columns(m, model, j, k[:, j]) for m, k in zip(measurements, masks, strict=True) if k[:, j].any()]
        sweep = _fit(j, parts) if parts else None
        if sweep is None:
            for mask in masks:
                mask[:, j] = False
        else:
            sweeps.append(sweep)
    return sweeps, {k: mask for k, mask in enumerate(masks) if mask.any()}


def as_prior(sweeps: list[Sweep], model: TorqueModel) -> Prior:
    """The sweeps as a prior of the model's friction columns."""
    prior = Prior.none(model.p)
    for s in sweeps:
        # the weight on a slide is as constant as an offset: its sweep shows their sum, which is no prior of either
        kinds = FRICTION[: FRICTION.index("offset")] if model.arm.tree.prismatic[s.joint] else FRICTION
        index = [model.friction_column(kind, s.joint) for kind in kinds]
        prior.mean[index] = s.mean[: len(kinds)]
        prior.precision[np.ix_(index, index)] = np.linalg.inv(s.covariance[: len(kinds), : len(kinds)])
    return prior


def _columns(m: Measurement, model: TorqueModel, j: int, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    tr = m.trajectory
    slip = model.slip(tr.q)[:, j]
    fine = np.stack([tr.dq[:, j], slip, np.ones(len(slip)), np.cos(tr.q[:, j]), np.sin(tr.q[:, j])], axis=1)
    posture = np.round(m.rows(np.delete(tr.q, j, axis=1))[keep], 2)
    return m.rows(fine)[keep], m.rows(m.tau[:, j])[keep], posture


def _fit(j: int, parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Sweep | None:
    a, b, posture = (np.concatenate(x) for x in zip(*parts, strict=True))
    if not (np.any(a[:, 0] > 0) and np.any(a[:, 0] < 0)) or np.ptp(np.abs(a[:, 0])) < 0.3 * np.abs(a[:, 0]).max():
        return None
    _, group = np.unique(posture, axis=0, return_inverse=True)
    groups = group.max() + 1
    if groups > 4:
        return None
    gravity = np.zeros((len(a), 2 * groups))
    gravity[np.arange(len(a)), 2 * group] = a[:, 3]
    gravity[np.arange(len(a)), 2 * group + 1] = a[:, 4]
    design = np.concatenate([a[:, :3], gravity], axis=1)
    if len(b) < 4 * design.shape[1]:
        return None
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    x, *_ = np.linalg.lstsq(design / scale, b, rcond=1e-10)
    e = b - design / scale @ x
    correlation = float(np.clip(e[1:] @ e[:-1] / max(e @ e, 1e-300), 0.0, 0.98))
    inflation = (1 + correlation) / (1 - correlation)
    variance = e @ e / (len(b) - design.shape[1]) * inflation
    covariance = inverse(design.T @ design) * variance
    return Sweep(j, (x / scale)[:3], covariance[:3, :3])
