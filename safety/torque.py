"""|tau| <= tau_max and sum |tau dq| <= power_max for every parameter set that the arm may have, at every sample that is sent.

`safety.bounds` has the interval of torque over the box of parameters, with every effect of the arm's file. Half the step to the
neighbouring sample is added, to cover the time between two samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety.bounds import TorqueBounds
from safety.parameters import missing_facts
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.interval import Interval
from sim.trajectory import Trajectory

CHUNK = 20_000
# Universal Robots' safety presets allow up to 1000 W of mechanical power ("least restricted"), the usual preset 300 W
POWER_MAX = 1000.0
# s: windings of servo drives take about a minute or more to warm up (thermal time constants of catalogue servo motors, 30 s to
# 60 min), so a shorter peak above the continuous torque does no harm
WARMING = 30.0


@dataclass(frozen=True)
class Torque:
    """tau_hat (N, n) N m: what the drives should report, friction included; doubt (N, n) N m: half-width of its interval.

    most (N, n) N m: the largest torque of the motor, or of its reading, which its drive counts; limit (n,) N m: what it
    delivers.
    """

    tau_hat: np.ndarray
    doubt: np.ndarray
    most: np.ndarray
    limit: np.ndarray


def torque_interval(
    motion: Trajectory, arm: Arm, cell: Cell, bounds: TorqueBounds | None = None, beside: float = 0.0
) -> Torque:
    """Expected torque of each sample and half-width of its interval over the parameter box; `bounds` saves building them again.

    `most` is for joints that may be `beside` rad off the motion.
    """
    bounds = bounds or TorqueBounds(arm, cell)
    tau_hat, doubt, most = np.empty_like(motion.q), np.empty_like(motion.q), np.empty_like(motion.q)
    limit = arm.tau_max
    for start in range(0, max(len(motion), 1), CHUNK):
        part = slice(start, start + CHUNK)
        q, dq, ddq = (Interval(x[part], x[part]) for x in (motion.q, motion.dq, motion.ddq))
        box = bounds.of(q, dq, ddq, motion.t[part], steep=beside > 0)
        tau_hat[part], doubt[part], most[part], limit = (
            box.reading.middle, box.reading.half, box.most + beside * box.steep, box.limit,
        )  # fmt: skip
    return Torque(tau_hat, doubt, most, limit)


def check_torque(motion: Trajectory, torque: Torque, arm: Arm) -> dict[str, float]:
    """SafetyStop if torque, RMS torque or power may exceed its limit; returns the largest share of each limit that is used."""
    worst = torque.most + _half_steps(torque.tau_hat)
    inside = np.isfinite(worst) & (worst <= torque.limit)
    if not inside.all():
        k, j = np.argwhere(~inside)[0]
        raise SafetyStop(
            f"{arm.joint_names[j]}: torque up to {worst[k, j]:.4g} N m (expected {torque.tau_hat[k, j]:.4g}, doubt "
            f"{torque.doubt[k, j]:.4g}) exceeds {torque.limit[j]:.4g} N m at t={motion.t[k]:.4f} s; plan a slower motion, declare the "
            f"real payload in the cell file, or state better known masses in [prior] of arm.toml{missing_facts(arm, j)}"
        )
    power = np.sum(worst * (np.abs(motion.dq) + _half_steps(motion.dq)), axis=1)
    inside = np.isfinite(power) & (power <= POWER_MAX)
    if not inside.all():
        k = int(np.argmin(inside))
        raise SafetyStop(
            f"{arm.name}: mechanical power up to {power[k]:.4g} W exceeds {POWER_MAX:g} W at t={motion.t[k]:.4f} s; plan a slower motion"
        )
    rms, rated = largest_rms(motion.t, worst), arm.tau_max if arm.torque_continuous is None else arm.torque_continuous
    inside = np.isfinite(rms) & (rms <= rated)
    if not inside.all():
        j = int(np.argmin(inside))
        raise SafetyStop(
            f"{arm.joint_names[j]}: RMS torque up to {rms[j]:.4g} N m over {min(WARMING, motion.duration):.3g} s exceeds the {rated[j]:.4g} N m "
            f"that its drive can hold indefinitely (torque_continuous); plan a slower motion, or one about a posture that needs less torque"
            f"{missing_facts(arm, j)}"
        )
    return {
        "tau": float(np.max(worst / torque.limit)), "rms torque": float(np.max(rms / rated)), "power": float(np.max(power) / POWER_MAX),
    }  # fmt: skip


def suffices(motion: Trajectory, arm: Arm, cell: Cell) -> bool:
    """Whether the torque of every sample is within the limits, over the whole box of parameters."""
    torque = torque_interval(motion, arm, cell)
    return bool(np.all(torque.most <= torque.limit))


def largest_rms(t: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """(n,): largest RMS over any WARMING s of torque (N, n) at t (N,), or over all of it if it is shorter."""
    energy = np.vstack(
        (np.zeros((1, torque.shape[1])), np.cumsum(np.diff(t)[:, None] * np.maximum(torque[1:], torque[:-1]) ** 2, axis=0))
    )
    window = min(WARMING, float(t[-1] - t[0]))
    begin = t[t <= t[-1] - window * (1 - 1e-9)]
    end = np.clip(np.searchsorted(t, begin + window, side="left"), 1, len(t) - 1)
    return np.asarray(np.sqrt(np.max(energy[end] - energy[: len(begin)], axis=0) / window))


def _half_steps(x: np.ndarray) -> np.ndarray:
    """Half of the larger step to a neighbouring sample, (N, n)."""
    step = np.abs(np.diff(x, axis=0)) / 2
    return np.maximum(np.vstack((step, np.zeros((1, x.shape[1])))), np.vstack((np.zeros((1, x.shape[1])), step)))
