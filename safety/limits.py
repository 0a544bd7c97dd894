"""lo <= q^(k)(t) <= hi for every instant of a motion, k = 0..3: verified, not sampled.

Between two samples a Trajectory is the quintic through position, speed and acceleration at both ends. In Bernstein form
x(s) = sum_i b_i B_i(s), it lies in the hull of its coefficients b_i (Farin 2002, "Curves and Surfaces for CAGD", section 4.3).
The end coefficients are values of the motion itself. A hull inside the limits therefore proves the piece, and an end outside
refutes it; anything between is halved (de Casteljau) until decided. What stays undecided is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.arm import Arm
from sim.errors import SafetyStop
from sim.required import require_limits
from sim.trajectory import Trajectory

ROUNDING = 1e-9
HALVINGS = 20
UNITS = {"q": "rad", "dq": "rad/s", "ddq": "rad/s^2", "jerk": "rad/s^3"}


@dataclass(frozen=True)
class BernsteinPieces:
    """Bernstein coefficients of every piece of a motion: q (N-1, 6, n), dq (N-1, 5, n), ddq (N-1, 4, n), jerk (N-1, 3, n)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    jerk: np.ndarray


def pieces(motion: Trajectory) -> BernsteinPieces:
    """The quintic pieces of a motion and their three derivatives; end coefficients are the samples themselves, bit for bit."""
    h = np.diff(motion.t)[:, None]
    q0, q1 = motion.q[:-1], motion.q[1:]
    v0, v1 = motion.dq[:-1], motion.dq[1:]
    a0, a1 = motion.ddq[:-1], motion.ddq[1:]
    q = np.stack(
        (q0, q0 + h / 5 * v0, q0 + 2 * h / 5 * v0 + h**2 / 20 * a0, q1 - 2 * h / 5 * v1 + h**2 / 20 * a1, q1 - h / 5 * v1, q1),
        axis=1,
    )
    # the inner coefficients come from the mean speed, not from differences of positions: no digits are lost to cancellation
    mean = (q1 - q0) / h
    dq = np.stack((v0, v0 + h / 4 * a0, 5 * mean - 2 * (v0 + v1) - h / 4 * (a0 - a1), v1 - h / 4 * a1, v1), axis=1)
    ddq = np.stack((a0, 4 / h * (dq[:, 2] - dq[:, 1]), 4 / h * (dq[:, 3] - dq[:, 2]), a1), axis=1)
    jerk = 3 / h[:, None] * np.diff(ddq, axis=1)
    return BernsteinPieces(motion.t, q, dq, ddq, jerk)


@dataclass(frozen=True)
class Excess:
    """Where a piece leaves its limits: index of the piece, joint, value, and whether that value is actually reached."""

    piece: int
    joint: int
    value: float
    reached: bool


def first_excess(b: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> Excess | None:
    """The first piece that is not verified to stay in [lo, hi], or None. b (M, d+1, n) coefficients, lo hi (n,).

    `ROUNDING`, relative to the larger limit, is what floating-point evaluation of an inner coefficient may add.
    """
    slack = ROUNDING * np.maximum(np.abs(lo), np.abs(hi))
    ends = b[:, [0, -1]]
    outside = ~((lo <= ends) & (ends <= hi)).all(axis=1)
    if outside.any():
        k, j = np.argwhere(outside)[0]
        return Excess(int(k), int(j), _farthest(ends[k, :, j], lo[j], hi[j]), True)
    k, j = np.nonzero(~((lo - slack <= b) & (b <= hi + slack)).all(axis=1))
    part, low, high, allowed = b[k, :, j], lo[j], hi[j], slack[j]
    if not len(part):
        return None
    for _ in range(HALVINGS):
        left, right = halves(part)
        middle = right[:, 0]
        inside = (low - allowed <= middle) & (middle <= high + allowed)
        if not inside.all():
            i = int(np.argmin(inside))
            return Excess(int(k[i]), int(j[i]), float(middle[i]), True)
        part = np.concatenate((left, right))
        k, j, low, high, allowed = (np.concatenate((x, x)) for x in (k, j, low, high, allowed))
        open_ = ~((low - allowed <= part.min(axis=1)) & (part.max(axis=1) <= high + allowed))
        part, k, j, low, high, allowed = (x[open_] for x in (part, k, j, low, high, allowed))
        if not len(part):
            return None
    return Excess(int(k[0]), int(j[0]), _farthest(part[0], low[0], high[0]), False)


def _farthest(values: np.ndarray, lo: float, hi: float) -> float:
    beyond = np.maximum(values - hi, lo - values)
    beyond[~np.isfinite(beyond)] = np.inf
    return float(values[int(np.argmax(beyond))])


def halves(b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (M, d+1) of the first and second half of each piece, by de Casteljau's algorithm."""
    left, right = np.empty_like(b), np.empty_like(b)
    row = b
    for i in range(b.shape[1]):
        left[:, i], right[:, -1 - i] = row[:, 0], row[:, -1]
        row = (row[:, :-1] + row[:, 1:]) / 2
    return left, right


def limits_of(arm: Arm) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(lo, hi) of q, dq, ddq and jerk; ConfigError asks for a limit that the arm does not have."""
    require_limits(arm, "q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max")
    return {
        "q": (arm.q_min, arm.q_max),
        "dq": (-arm.dq_max, arm.dq_max),
        "ddq": (-arm.ddq_max, arm.ddq_max),
        "jerk": (-arm.jerk_max, arm.jerk_max),
    }


def check_limits(motion: Trajectory, arm: Arm) -> dict[str, float]:
    """Verify position, speed, acceleration and jerk at every instant; returns the largest share of each limit that is used.

    SafetyStop names joint, quantity, value, limit and instant of the first piece that is not verified.
    """
    if motion.n != arm.n:
        raise SafetyStop(f"the motion has {motion.n} joints, {arm.name} has {arm.n}; plan the motion for this arm")
    form, used = pieces(motion), {}
    for name, (lo, hi) in limits_of(arm).items():
        b = getattr(form, name)
        excess = first_excess(b, lo, hi)
        if excess is not None:
            raise SafetyStop(_sentence(name, excess, motion, arm, lo, hi))
        middle, half = (lo + hi) / 2, (hi - lo) / 2
        used[name] = min(1.0, float(np.max(np.abs(b - middle) / half)))
    return used


def check_sent(sent: Trajectory, arm: Arm) -> None:
    """SafetyStop unless every sample, and every step from one to the next, is within the limits up to `ROUNDING`."""
    step = Trajectory(sent.t[1:], *(np.diff(sent.q, axis=0) / np.diff(sent.t)[:, None],) * 3) if len(sent) > 2 else None
    rows = [(name, getattr(sent, name), sent.t) for name in ("q", "dq", "ddq")]
    rows += [("dq", step.q, step.t)] if step else []
    for name, values, t in rows:
        lo, hi = limits_of(arm)[name]
        slack = ROUNDING * np.maximum(np.abs(lo), np.abs(hi))
        inside = (lo - slack <= values) & (values <= hi + slack)
        if not inside.all():
            k, j = np.argwhere(~inside)[0]
            raise SafetyStop(
                f"{arm.joint_names[j]}: {name} {values[k, j]:.6g} {UNITS[name]} at t={t[k]:.4f} s would be sent, outside "
                f"[{lo[j]:.6g}, {hi[j]:.6g}]; plan a slower or smaller motion"
            )


def _sentence(name: str, excess: Excess, motion: Trajectory, arm: Arm, lo: np.ndarray, hi: np.ndarray) -> str:
    j = excess.joint
    certain = "leaves" if excess.reached else "is not verified to stay in"
    return (
        f"{arm.joint_names[j]}: {name} {excess.value:.6g} {UNITS[name]} {certain} [{lo[j]:.6g}, {hi[j]:.6g}] between "
        f"t={motion.t[excess.piece]:.4f} s and {motion.t[excess.piece + 1]:.4f} s; plan a slower or smaller motion, "
        f"or correct the limits of {arm.name} if the arm allows more"
    )


def sampled(motion: Trajectory, t: np.ndarray) -> Trajectory:
    """The motion at the instants t (M,) s; exact at its own samples. ValueError if they are not within its time range."""
    form = pieces(motion)
    if not (np.all(t >= motion.t[0]) and np.all(t <= motion.t[-1])):
        raise ValueError(f"instants from {t.min()} to {t.max()} s leave the motion's {motion.t[0]} to {motion.t[-1]} s")
    k = np.clip(np.searchsorted(motion.t, t, side="right") - 1, 0, len(motion) - 2)
    s = ((t - motion.t[k]) / (motion.t[k + 1] - motion.t[k]))[:, None]
    values = []
    for b in (form.q, form.dq, form.ddq):
        row = b[k]
        while row.shape[1] > 1:
            row = (1 - s[:, None]) * row[:, :-1] + s[:, None] * row[:, 1:]
        values.append(row[:, 0])
    return Trajectory(t, *values)
