"""What may be missing from a model and look like a wrong reading: a load, a tilted base, a constant pull, a joint spring, a coupled transmission."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from calib.gate.fit import LEAST_ROWS, SLOW, GravityFit, fitted, gain, model_torque, moving
from calib.gate.search import SURE_GAIN, GainStep, steps
from calib.gate.signals import SHIFTS, Signals
from sim.arm import Arm
from sim.rigid_body import RigidBody

LIGHT = 0.05  # of the arm's mass, by which a load may come out negative where the model's own masses are too large


def mounting_torque(
    arm: Arm, s: Signals, fit: GravityFit, beside: Sequence[str] = ("tilt", "pull"), scaled: bool = True
) -> np.ndarray:
    """(R, n) torque of a load at the flange (a mass and its centre) and, `beside` it, of a tilted base and a constant pull on the last link,
    fitted to the readings that `fit` leaves unexplained. scaled: every joint's readings have a scale of their own; else the arm's masses hold as stated.

    The load's mass stays below the arm's; fitted alone, it is dropped where it reaches a bound. A tool, a workpiece, a wedge below the base
    and a hose make neither another arm nor another column.
    """
    body, tau = RigidBody(arm), model_torque(arm, s)
    columns = body.regressor(s.q, s.dq, s.ddq)[:, :, 10 * (arm.n - 1) : 10 * (arm.n - 1) + 4]
    if "tilt" in beside:  # gravity keeps its size
        level, still = np.linalg.svd(arm.tree.gravity[None])[2][1:], np.zeros_like(s.q)
        tilted = [body.inverse_dynamics(s.q, still, still, gravity=way) for way in level]
        columns = np.concatenate([columns, np.stack(tilted, axis=2)], axis=2)
    if "pull" in beside:
        columns = np.concatenate([columns, np.swapaxes(body.jacobian(s.q)[0], 1, 2)], axis=2)
    x, y = [], []
    in_motion = moving(s)
    for j in range(s.n):
        rows = np.flatnonzero(in_motion[:, j])
        if len(rows) < LEAST_ROWS or not fit.left[j] > 0:
            continue
        v = s.dq[rows, j]
        joint = np.column_stack([s.ddq[rows, j], v, np.tanh(v / SLOW), np.ones(len(rows)), tau[rows, j]])
        basis = np.linalg.qr(joint if scaled else joint[:, :-1])[0]
        both = np.column_stack([columns[rows, j], s.load[rows, j] - (0.0 if scaled else tau[rows, j])])
        rest = (both - basis @ (basis.T @ both)) / fit.left[j]
        x.append(rest[:, :-1])
        y.append(rest[:, -1])
    if not x:
        return np.zeros_like(tau)
    # a small motion hardly distinguishes a mass from a constant pull downwards
    lowest, most = np.full(columns.shape[2], -np.inf), np.full(columns.shape[2], np.inf)
    lowest[0], most[0] = -LIGHT * arm.tree.mass.sum(), arm.tree.mass.sum()
    design = np.concatenate(x)
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    found = lsq_linear(design / size, np.concatenate(y), (lowest * size, most * size))
    if not beside and found.active_mask[0]:  # fitted alone, a load whose mass is at a bound is no load
        return np.zeros_like(tau)
    out: np.ndarray = columns @ (found.x / size)
    return out


def is_missing(arm: Arm, s: Signals, found: GainStep) -> bool:
    """Whether something missing from the model explains more than a correction does, and leaves nothing to correct.

    The mounting is tried with a free scale of each joint's readings, and with the arm's masses as stated: with free scales a load hardly
    shows where each joint moves little. A spring or a transmission at the joints of the correction fits anything a little, so it must
    explain SURE_GAIN more. For a wrist whose transmission is coupled (exam seed 26113071), wrong signs gained 0.1 and the coupling 1.0; for
    a slide on a spring, 0.3 and the spring 5.
    """
    plain = fitted(s, model_torque(arm, s))
    loads = (mounting_torque(arm, s, plain, scaled=free) for free in (True, False))
    if any(_explains(arm, s, plain, load, found.gain) for load in loads):
        return True
    joints = found.correction.joints
    return any(
        _explains(arm, s, plain, _joint_torque(arm, s, joints, columns, least), found.gain + SURE_GAIN)
        for columns, least in ((_spring, 0.0), (_coupling, -np.inf))
    )


def without_springs(arm: Arm, s: Signals, joints: Sequence[int]) -> Signals:
    """The rows without the torque of a joint spring, at those of the joints where it explains SURE_GAIN more: it is not due to masses."""
    tau = model_torque(arm, s)
    beside = replace(s, load=s.load - _joint_torque(arm, s, joints, _spring, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        sprung = np.log(fitted(s, tau).left / fitted(beside, tau).left) > SURE_GAIN
    return replace(s, load=np.where(sprung, beside.load, s.load))


def without_mounting(arm: Arm, s: Signals, fit: GravityFit) -> Signals:
    """The rows without a load, a tilted base and a constant pull where these, with masses as stated, explain SURE_GAIN more than `fit`."""
    beside = replace(s, load=s.load - mounting_torque(arm, s, fit, scaled=False))
    return beside if gain(fit.left, fitted(beside, model_torque(arm, s)).left) > SURE_GAIN else s


def _spring(s: Signals, j: int) -> np.ndarray:
    """(R, 1) column of a spring: the joint's angle."""
    return s.q[:, [j]]


def _coupling(s: Signals, j: int) -> np.ndarray:
    """(R, k) columns of inertia and friction of a motor that the previous joint also turns, in either direction."""
    if j == 0:
        return np.zeros((len(s), 0))
    before, own = s.dq[:, j - 1], s.dq[:, j]
    return np.column_stack([s.ddq[:, j - 1], before, *(np.tanh((own + ratio * before) / SLOW) for ratio in (-1.0, 1.0))])


def _joint_torque(
    arm: Arm, s: Signals, joints: Sequence[int], columns: Callable[[Signals, int], np.ndarray], least: float
) -> np.ndarray:
    """(R, n) torque of extra columns (R, k) at some joints, with coefficients of at least `least`, fitted with those of calib.gate.fit."""
    tau, in_motion, out = model_torque(arm, s), moving(s), np.zeros(s.load.shape)
    for j in joints:
        rows, extra = np.flatnonzero(in_motion[:, j] & np.isfinite(s.load[:, j])), columns(s, j)
        if len(rows) < LEAST_ROWS or not extra.shape[1]:
            continue
        v = s.dq[:, j]
        own = np.column_stack([tau[:, j], s.ddq[:, j], v, np.tanh(v / SLOW)])
        x = np.concatenate([own, extra], axis=1)
        x = x - x[rows].mean(axis=0)
        size = np.maximum(np.linalg.norm(x[rows], axis=0), 1e-12)
        lowest = np.r_[np.zeros(own.shape[1]), np.full(extra.shape[1], least)]
        theta = lsq_linear(x[rows] / size, s.load[rows, j] - s.load[rows, j].mean(), (lowest, np.inf)).x / size
        out[:, j] = x[:, own.shape[1] :] @ theta[own.shape[1] :]
    return out


def _explains(arm: Arm, s: Signals, plain: GravityFit, missing: np.ndarray, least: float) -> bool:
    """Whether a missing torque (R, n) lowers the residuals by more than `least` nats and leaves no correction that helps."""
    beside = replace(s, load=s.load - missing, late=s.late - missing)
    explained = gain(plain.left, fitted(beside, model_torque(arm, s)).left)
    return explained > least and not steps(arm, beside, SHIFTS)[0]
