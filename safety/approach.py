"""Jerk-limited moves to where a motion begins, and to rest from where it ends, by Ruckig (Berscheid, Kroeger 2021,
doi:10.15607/RSS.2021.XVII.015).

Ruckig's community version does not enforce position limits and sends intermediate waypoints to a cloud service. Therefore
waypoints are never set, and its result is a Trajectory like any other, which `clear` must verify before it is driven.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError
from ruckig import Trajectory as RuckigTrajectory

from sim.arm import Arm
from sim.errors import SafetyStop
from sim.finite import is_finite
from sim.trajectory import Trajectory

# Shares of the arm's limits for an approach, tried in this order; jerk is halved so that no knot needs more than its limit
SHARES = (0.25, 0.1, 0.04)
NEAR = 1e-5
SAME = 1e-9


@dataclass(frozen=True)
class Joined:
    """An approach, a motion and its stop as one Trajectory; the motion itself lasts from `begins` to `ends` s."""

    approach: Trajectory | None
    trajectory: Trajectory
    begins: float
    ends: float


def joined(motion: Trajectory, q: np.ndarray, arm: Arm, rate: float, share: float) -> Joined:
    """`motion` with an approach from rest at q (n,) rad before it and, if it does not end at rest, a stop after it.

    The approach takes a whole number of periods, so that the motion's samples are sent as planned.
    """
    _require_posture(q, arm)
    approach = None if _same(q, motion) else _approach(q, motion, arm, rate, share)
    parts = [motion] if approach is None else [approach, motion]
    if np.any(np.abs(motion.dq[-1]) > SAME) or np.any(np.abs(motion.ddq[-1]) > SAME):
        parts.append(_to_rest(motion, arm))
    begins = 0.0 if approach is None else approach.duration
    return Joined(approach, _concatenated(parts), begins, begins + motion.duration)


def move(q_from: np.ndarray, q_to: np.ndarray, arm: Arm, rate: float, share: float) -> Trajectory:
    """From rest at q_from (n,) rad to rest at q_to (n,) rad, along a straight line of joint angles."""
    for q in (q_from, q_to):
        _require_posture(q, arm)
    zero = np.zeros((2, arm.n))
    target = Trajectory(np.array([0.0, 1.0]), np.vstack((q_to, q_to)), zero, zero)
    return _approach(q_from, target, arm, rate, share)


def _require_posture(q: np.ndarray, arm: Arm) -> None:
    if not is_finite(q, arm.n):
        raise SafetyStop(f"posture {q!r} is not {arm.n} finite numbers; no move leads there")


def _same(q: np.ndarray, motion: Trajectory) -> bool:
    at_rest = np.all(np.abs(motion.dq[0]) <= SAME) and np.all(np.abs(motion.ddq[0]) <= SAME)
    return bool(np.all(np.abs(q - motion.q[0]) <= SAME) and at_rest)


def _approach(q: np.ndarray, motion: Trajectory, arm: Arm, rate: float, share: float) -> Trajectory:
    wanted = InputParameter(arm.n)
    wanted.current_position = q
    wanted.current_velocity = wanted.current_acceleration = np.zeros(arm.n)
    wanted.target_position, wanted.target_velocity = motion.q[0], motion.dq[0]
    wanted.target_acceleration = motion.ddq[0]
    wanted.max_velocity = np.maximum(share * arm.dq_max, np.abs(motion.dq[0]) * 1.01)
    wanted.max_acceleration = np.maximum(share * arm.ddq_max, np.abs(motion.ddq[0]) * 1.01)
    wanted.max_jerk = 0.5 * arm.jerk_max
    shortest = _calculated(wanted, arm.n).duration
    wanted.minimum_duration = max(np.ceil(shortest * rate), 1.0) / rate
    return _knots(_calculated(wanted, arm.n), (q, motion.q[0], motion.dq[0], motion.ddq[0]), wanted.minimum_duration)


def _to_rest(motion: Trajectory, arm: Arm) -> Trajectory:
    wanted = InputParameter(arm.n)
    wanted.control_interface = ControlInterface.Velocity
    wanted.current_position, wanted.current_velocity = motion.q[-1], motion.dq[-1]
    wanted.current_acceleration = motion.ddq[-1]
    wanted.target_velocity = wanted.target_acceleration = np.zeros(arm.n)
    wanted.max_acceleration = np.maximum(0.9 * arm.ddq_max, np.abs(motion.ddq[-1]))
    wanted.max_jerk = 0.5 * arm.jerk_max
    return _knots(_calculated(wanted, arm.n), None, None)


def _calculated(wanted: InputParameter, n: int) -> RuckigTrajectory:
    found = RuckigTrajectory(n)
    try:
        Ruckig(n).calculate(wanted, found)
    except (RuckigError, ValueError) as error:  # it throws for some of its error codes, others are not in its own enumeration
        raise SafetyStop(
            f"no jerk-limited motion from {wanted.current_position} to {wanted.target_position}: {error}"
        ) from error
    return found


def _knots(
    found: RuckigTrajectory, ends: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None, duration: float | None
) -> Trajectory:
    """Ruckig's result at every instant at which a joint's jerk changes; between two of them it is a cubic, so this is exact."""
    instants = [0.0, found.duration]
    for profile in found.profiles[0]:
        begin = float(profile.brake.duration)
        instants += [begin, *(begin + np.cumsum(profile.t))]
    t = np.unique(np.clip(instants, 0.0, found.duration))
    keep = np.concatenate(([True], np.diff(t) > NEAR))
    t = t[keep]
    t[-1] = found.duration
    q, dq, ddq = (np.array(x) for x in zip(*(found.at_time(x) for x in t), strict=True))
    if ends is not None:
        q[0], q[-1], dq[-1], ddq[-1] = ends
        dq[0] = ddq[0] = 0.0
    else:
        dq[-1] = ddq[-1] = 0.0
    if duration is not None:
        t[-1] = duration
    return Trajectory(t, q, dq, ddq)


def _concatenated(parts: list[Trajectory]) -> Trajectory:
    """The parts in sequence. Where two meet, the last sample of the earlier one stands for the first of the later one."""
    t, rows, now = [parts[0].t - parts[0].t[0]], [parts[0]], parts[0].duration
    for part in parts[1:]:
        t.append(part.t[1:] - part.t[0] + now)
        rows.append(part)
        now += part.duration
    names = ("q", "dq", "ddq")
    values = [np.vstack([getattr(rows[0], x), *(getattr(r, x)[1:] for r in rows[1:])]) for x in names]
    return Trajectory(np.concatenate(t), *values)
