"""What an arm carries and how it stands: a load, a tilted base or a constant pull makes neither another arm nor another column."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.gate.fit import LEAST_ROWS, SLOW, GravityFit, fitted, model_torque, moving
from calib.gate.search import steps
from calib.gate.signals import SHIFTS, Signals
from sim.arm import Arm
from sim.rigid_body import RigidBody

LIGHT = 0.05  # of the arm's mass, that a load may come out below zero where the model's own masses are too large


def mounting_torque(arm: Arm, s: Signals, fit: GravityFit, tilt: bool = True, scaled: bool = True) -> np.ndarray:
    """(R, n) torque of a load at the flange (a mass and its centre), and with `tilt` of a tilted base and a constant pull on the last link, that
    explain best what `fit` leaves. scaled: every joint's readings may have a scale of their own; else the arm's masses are as stated.

    Zero where the load would be none: a tool, a workpiece, a wedge below the base and a hose make neither another arm nor another column.
    """
    body, tau = RigidBody(arm), model_torque(arm, s)
    columns = body.regressor(s.q, s.dq, s.ddq)[:, :, 10 * (arm.n - 1) : 10 * (arm.n - 1) + 4]
    if tilt:  # gravity keeps its size
        level = np.linalg.svd(arm.tree.gravity[None])[2][1:]
        tilted = [body.inverse_dynamics(s.q, s.dq, s.ddq, arm.tree.gravity + way) - tau for way in level]
        pulled = np.swapaxes(body.jacobian(s.q)[0], 1, 2)
        columns = np.concatenate([columns, np.stack(tilted, axis=2), pulled], axis=2)
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
    found = np.linalg.lstsq(np.concatenate(x), np.concatenate(y), rcond=1e-6)[0]
    if not -LIGHT < found[0] / arm.tree.mass.sum() < 1.0:
        return np.zeros_like(tau)
    out: np.ndarray = columns @ found
    return out


def is_mounting(arm: Arm, s: Signals, gain: float) -> bool:
    """Whether a load, a tilted base or a constant pull explains more than a correction of that gain does, and leaves nothing to correct.

    Asked with a scale of each joint's readings left free, and with the arm's masses as they are stated: free scales leave little to tell a
    load by where each joint moves little.
    """
    plain = fitted(s, model_torque(arm, s))
    return any(_explains(arm, s, plain, mounting_torque(arm, s, plain, scaled=free), gain) for free in (True, False))


def _explains(arm: Arm, s: Signals, plain: GravityFit, mounted: np.ndarray, gain: float) -> bool:
    """Whether torque that the mounting takes, (R, n), lowers the residuals by more than `gain` nats, with no correction left that helps."""
    beside = replace(s, load=s.load - mounted, late=s.late - mounted)
    ratio = np.log(plain.left / fitted(beside, model_torque(arm, s)).left)
    return float(ratio[np.isfinite(ratio)].sum()) > gain and not steps(arm, beside, SHIFTS)[0]
