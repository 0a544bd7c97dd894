"""Where an arm comes to rest that is stopped anywhere in a motion: at its samples, for planning only; `safety.tube` proves it.

Our own stop slows every joint by a share of ddq_max; the device's keeps the last speed for its reaction time and slows down by a share of
its deceleration. The share is the hardest of `safety.tube.SHARES` for which the torque suffices.
"""

from __future__ import annotations

import numpy as np

from drivers.driver import DeviceStop
from safety.bounds import TorqueBounds
from safety.torque import POWER_MAX, torque_interval
from safety.tube import SHARES
from sim.arm import Arm
from sim.cell import Cell
from sim.trajectory import Trajectory

# shares of torque and power: a proof holds for a following error and whole boxes of states, what suffices by less is not counted on
PREDICTED, POWERED = 0.9, 0.5


def stops_of(motion: Trajectory, arm: Arm, cell: Cell, stop: DeviceStop, bounds: TorqueBounds) -> tuple[np.ndarray, np.ndarray]:
    """(4 N, n) rad half-way through and at the end of our stop and the device's from each sample, and (n,) the largest share of tau_max that
    they take, or of the power."""
    fastest = np.abs(motion.dq)
    if stop.proportional:
        fastest = np.broadcast_to(fastest.max(axis=1, keepdims=True), fastest.shape)
    # rad/s^2 of every joint at the full deceleration
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
