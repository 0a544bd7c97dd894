"""How well an arm's own model explains the load readings, joint by joint, with friction and a scale free but never of the wrong sign.

    y_j = a tau_j + r ddq_j + v dq_j + c tanh(dq_j / 0.02) + o,    a, r, v, c >= 0

tau is the torque along the motion of the arm's rigid bodies and of the springs, couplings and pulls that its file states. Friction
dissipates energy, inertia is positive and gravity pulls down: a reading that needs one of them negative has the wrong sign, column or
motion. Residuals are compared between ways of reading the same data, never with an absolute bound: a bad model is bad either way.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.gate.signals import Signals
from sim.arm import Arm
from sim.effects import Stage, effect_named
from sim.prediction import load_on_gears
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

SLOW = 0.02  # rad/s, m/s of a slide: near zero speed, dry friction has no fixed size
LEAST_ROWS = 40
# s in motion below which a joint's readings match another way of reading by chance: one in six of the 1.5 to 2.5 s parts of good recordings did
LEAST_SECONDS = 3.0
MOVING = 0.04  # of a joint's highest speed; below, its load may be anything within its dry friction
CORRELATED = 8.0  # neighbouring rows are not independent, and the model's own errors are not noise
BOTH_WAYS = 0.05  # of the rows, for dry friction to be distinguishable from an offset
FEW = 1e-9
BEFORE_GEAR = (
    Stage.ENCODER,
    Stage.FORCE,
    Stage.JOINT,
)  # of effects for which the fit has no column; those of links are in the arm's tree
SUBSETS = [list(at) for count in range(1, 5) for at in itertools.combinations(range(4), count)]


def gain(before: np.ndarray, after: np.ndarray) -> float:
    """sum ln(before / after) over the joints where both are known, in nats."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.log(before / after)
    return float(ratio[np.isfinite(ratio)].sum())


@dataclass(frozen=True)
class Normal:
    """Normal equations of every joint: gram (n, 4, 4) of the scaled columns, norm (n, 4) by which they were scaled, rows (n,) their number,
    and x (n,) the row indices and columns of each joint, against which other readings are fitted."""

    gram: np.ndarray
    norm: np.ndarray
    rows: np.ndarray
    x: list[tuple[np.ndarray, np.ndarray]]

    def left(self, y: np.ndarray) -> np.ndarray:
        """(n, K) share of the columns y (R, K) that each joint's model leaves unexplained; NaN where joint or column is not informative."""
        size = np.full((len(self.x), y.shape[1]), np.nan)
        for j, (rows, _) in enumerate(self.x):
            if len(rows):
                size[j] = y[rows].std(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.solved(y)[0] / np.where(size > 0, size, np.nan)

    def solved(self, y: np.ndarray, driven: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(n, K) standard deviation of the residual, and the coefficients a, r, v, c (n, 4, K).

        driven: the torque in proportion to speed drives the joint instead of braking it, -v for v.
        """
        n, k = len(self.x), y.shape[1]
        own, power = np.zeros((n, 4, k)), np.full((n, k), np.nan)
        for j, (rows, x) in enumerate(self.x):
            if len(rows):
                part = y[rows]
                part = part - part.mean(axis=0)
                own[j], power[j] = x.T @ part, (part**2).sum(axis=0)
        own[~np.isfinite(own)] = 0.0
        way = np.array([1.0, 1.0, -1.0 if driven else 1.0, 1.0])
        theta, rest = nonnegative(self.gram * np.outer(way, way), own * way[:, None], power)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(rest / self.rows[:, None]), theta / self.norm[:, :, None]

    def own(self, y: np.ndarray) -> np.ndarray:
        """(n,) share of its own column of y (R, n) that each joint leaves."""
        return own_of([(self, y)])[0]


@dataclass(frozen=True)
class GravityFit:
    """The fit of every joint's own column.

    left (n,) is the standard deviation of the residual, NaN where the joint is not informative; size (n,) that of its readings; signal (n,)
    that of a tau_j, the part due to masses. scale, scale_std (n,) are a and its standard deviation. dry (n,) is c, NaN where the joint moves
    one way only and c is an offset.
    """

    left: np.ndarray
    size: np.ndarray
    scale: np.ndarray
    scale_std: np.ndarray
    dry: np.ndarray
    signal: np.ndarray


def model_torque(arm: Arm, s: Signals) -> np.ndarray:
    """(R, n) torque along the motion of the arm's rigid bodies and of the springs, couplings and pulls that its file states."""
    if len(s) < 2 or not any(effect_named(e.effect).stage in BEFORE_GEAR for e in arm.effects):
        return RigidBody(arm).inverse_dynamics(s.q, s.dq, s.ddq)
    return load_on_gears(arm, trajectory(s))


def trajectory(s: Signals) -> Trajectory:
    """The motion as a trajectory, with the rows of several recordings one after another."""
    return Trajectory(np.median(np.diff(s.t)) * np.arange(len(s)), s.q, s.dq, s.ddq)


def normal(s: Signals, tau: np.ndarray) -> Normal:
    """The normal equations of the motion in s with the model torques tau (R, n)."""
    n = s.n
    gram, norm, count = np.tile(np.eye(4), (n, 1, 1)), np.full((n, 4), np.inf), np.full(n, np.nan)
    parts = []
    in_motion = moving(s)
    step = float(np.median(np.diff(s.t))) if len(s) > 1 else np.inf
    for j in range(n):
        rows = np.flatnonzero(in_motion[:, j])
        if len(rows) < LEAST_ROWS or len(rows) * step < LEAST_SECONDS:
            parts.append((rows[:0], np.zeros((0, 4))))
            continue
        v = s.dq[rows, j]
        x = np.column_stack([tau[rows, j], s.ddq[rows, j], v, np.tanh(v / SLOW)])
        x -= x.mean(axis=0)
        size = np.sqrt((x**2).sum(axis=0))
        size[~(size > 1e-9)] = np.inf
        x /= size
        gram[j], norm[j], count[j] = x.T @ x, size, len(rows)
        parts.append((rows, x))
    return Normal(gram, norm, count, parts)


def own_of(pairs: Sequence[tuple[Normal, np.ndarray]]) -> list[np.ndarray]:
    """For each pair of equations and readings y (R, n): (n,) share of its own column that each joint leaves. All are solved at once.

    A share and not an RMS: with other motion columns other rows count, and where a joint stands its torque is small, whatever it means.
    """
    right, power = [], []
    for equations, y in pairs:
        for j, (rows, x) in enumerate(equations.x):
            part = y[rows, j] - y[rows, j].mean() if len(rows) else y[:0, j]
            right.append(x.T @ part)
            power.append(part @ part if len(rows) else np.nan)
    sides = np.array(right)[:, :, None]
    sides[~np.isfinite(sides)] = 0.0
    rest = nonnegative(np.concatenate([equations.gram for equations, _ in pairs]), sides, np.array(power)[:, None])[1][:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        left = np.sqrt(rest / np.where(np.array(power) > 0, power, np.nan))
    return list(left.reshape(len(pairs), -1))


def fitted(s: Signals, tau: np.ndarray) -> GravityFit:
    """The fit of every joint's own load."""
    equations = normal(s, tau)
    left, theta = equations.solved(s.load)
    n = s.n
    at = np.arange(n)
    a, c, own = theta[at, 0, at], theta[at, 3, at], left[at, at]
    size, signal, std = (np.full(n, np.nan) for _ in range(3))
    turns = np.zeros(n, dtype=bool)
    for j, (rows, _) in enumerate(equations.x):
        if not len(rows):
            continue
        size[j] = np.std(s.load[rows, j])
        forward = float(np.mean(s.dq[rows, j] > 0))
        turns[j] = min(forward, 1 - forward) > BOTH_WAYS
        signal[j] = a[j] * np.std(tau[rows, j])
        free = np.linalg.inv(equations.gram[j] + 1e-6 * np.eye(4))[0, 0]
        std[j] = np.sqrt(free * CORRELATED) * own[j] / equations.norm[j, 0]
    silent = ~np.isfinite(own)
    return GravityFit(own, size, np.where(silent, np.nan, a), std, np.where(silent | ~turns, np.nan, c), signal)


def moving(s: Signals) -> np.ndarray:
    """(R, n) rows in which each joint moves; none for a joint whose speed does not exceed SLOW in 5 % of the rows.

    For such a joint, a slow slide or an axis nearly at rest, the rows beyond half of SLOW are only its peaks. Its friction and load do not
    change there, so any way of reading that fits their noise would gain.
    """
    speed = np.abs(s.dq)
    fastest = np.quantile(speed, 0.95, axis=0) if len(speed) else np.zeros(s.n)
    moves: np.ndarray = (speed > np.maximum(MOVING * fastest, 0.5 * SLOW)) & (fastest > SLOW)
    return moves


def nonnegative(gram: np.ndarray, own: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares with every coefficient >= 0: the coefficients (n, 4, K) and the residual power (n, K).

    gram (n, 4, 4), right sides own (n, 4, K) and their power (n, K). The solution is the best feasible one among the unconstrained solutions
    of all subsets of columns.
    """
    best: np.ndarray = power.copy()
    theta: np.ndarray = np.zeros_like(own)
    usable = np.diagonal(gram, axis1=1, axis2=2) > 0.5
    for at in SUBSETS:
        part = gram[:, at][:, :, at] + FEW * np.eye(len(at))
        solved = np.linalg.solve(part, own[:, at])
        rest = power - (solved * own[:, at]).sum(axis=1)
        better = np.all(solved >= 0, axis=1) & (rest < best) & np.all(usable[:, at], axis=1, keepdims=True)
        best = np.where(better, rest, best)
        full = np.zeros_like(own)
        full[:, at] = solved
        theta = np.where(better[:, None, :], full, theta)
    return theta, np.maximum(best, 1e-12 * power)
