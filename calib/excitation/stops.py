"""Where stops from the samples of a motion come to rest: for planning only; `safety.tube` verifies stops.

Our stop decelerates every joint at a share of ddq_max. The device's keeps the last speed for its reaction time, then
decelerates at a share of its own deceleration. The share is the largest of `safety.tube.SHARES` for which the torque suffices.
"""

from __future__ import annotations

import numpy as np

from drivers.driver import DeviceStop
from safety.bounds import TorqueBounds
from safety.device_stops import CREEP
from safety.torque import POWER_MAX, torque_interval
from safety.tube import SHARES
from sim.arm import Arm
from sim.cell import Cell
from sim.trajectory import Trajectory

# shares of torque and power that count as sufficient: a proof also covers a following error and whole boxes of states
PREDICTED, POWERED = 0.9, 0.5
# random directions of motion in which the gentlest stop is tried at each posture
DIRECTIONS = 8


def stops_of(motion: Trajectory, arm: Arm, cell: Cell, stop: DeviceStop, bounds: TorqueBounds) -> tuple[np.ndarray, np.ndarray]:
    """Positions (4 N, n) rad of the stops from each sample; (n,) largest share of tau_max, or of the power, that they take.

    The positions are halfway along the braking path and at its end, for our stop and then for the device's.
    """
    fastest = np.abs(motion.dq)
    if stop.proportional:
        fastest = np.broadcast_to(fastest.max(axis=1, keepdims=True), fastest.shape)
    # rad/s^2: full deceleration of every joint
    own = np.where(np.abs(motion.dq) > 0, arm.ddq_max, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        device = np.where(fastest > 0, stop.deceleration * np.abs(motion.dq) / fastest, 0.0)
    passed, taken = [], np.zeros(arm.n)
    for reaction, full in ((0.0, own), (stop.reaction, device)):
        for share in SHARES:
            slowing = Trajectory(motion.t, motion.q, motion.dq, -np.sign(motion.dq) * share * full)
            torque = torque_interval(slowing, arm, cell, bounds, cell.table.motion.following_error)
            power = float(np.max(np.sum(torque.most * np.abs(motion.dq), axis=1))) / POWER_MAX
            use = np.maximum((torque.most / torque.limit).max(axis=0), power * PREDICTED / POWERED)
            if np.all(use <= PREDICTED):
                break
        taken = np.maximum(taken, use)
        with np.errstate(divide="ignore", invalid="ignore"):
            braking = np.where(full > 0, np.abs(motion.dq) / (share * full), 0.0)
        passed += [motion.q + motion.dq * (reaction + part * braking) for part in (0.25, 0.5)]
    return np.concatenate(passed), taken


def gentlest_stop(q: np.ndarray, arm: Arm, cell: Cell, stop: DeviceStop, bounds: TorqueBounds) -> np.ndarray:
    """(N, n) share of the usable torque that the gentlest stop takes at postures q (N, n) rad, however slow the motion is.

    The usable torque is PREDICTED of the limit. The worst of DIRECTIONS of motion counts. Each joint decelerates at the least
    share of ddq_max or of the device's deceleration, whichever is larger.
    """
    slowing = SHARES[-1] * np.maximum(arm.ddq_max, stop.deceleration)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (DIRECTIONS, arm.n))
    t, twice = np.arange(len(q) + 1, dtype=float), np.concatenate([q, q[-1:]])  # a motion has at least two instants
    out = np.zeros_like(q)
    for sign in signs:
        dq, ddq = (np.broadcast_to(x, twice.shape) for x in (CREEP * sign, -slowing * sign))
        torque = torque_interval(Trajectory(t, twice, dq, ddq), arm, cell, bounds, cell.table.motion.following_error)
        out = np.maximum(out, (torque.most / (PREDICTED * torque.limit))[:-1])
    return out
