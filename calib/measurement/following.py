"""What the following error, command less reading, tells of effects that stand between motor and link.

A drive that closes its loop on the motor holds the motor at the command q_cmd, and the link lags by what the gear gives:

    q_cmd - q = c X + b s(load) + e

X what any drive makes of a motion (1, speed and acceleration of link and command, torque and its rate, load and load |load|, the sense of
motion), s the effect's lead per unit of its parameter b (Effect.motor_lead), e correlated. b comes from least squares, its standard
deviation from leaving out one block of BLOCK seconds at a time. A drive that closes its loop on the link shows nothing, so that no lead
speaks against no effect.

B. Efron, C. Stein (1981), doi:10.1214/aos/1176345462, for the jackknife.
"""

from __future__ import annotations

import numpy as np

from calib.measurement.observed import Key, Observed
from calib.measurement.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm
from sim.effects import EFFECTS
from sim.prediction import by_stage, link_side

BLOCK = 1.0  # s
LEAST_BLOCKS = 8
LEAST_SHARE = 0.02  # of the samples, with the load to either side
# Standard deviation of value over its own on joints without the effect: 4373 pairs of joint and recording of four exams.
OPTIMISM = 1.2
# rad/s: two widths of the sense of motion, between which the widths of dry friction lie
SENSES = (3e-3, 3e-2)


def observed(log: Log, m: Measurement, arm: Arm) -> dict[Key, Observed]:
    """Per effect and joint what a recording shows; nothing where it has no commands or its load keeps one sign."""
    followed: dict[Key, Observed] = {}
    read = np.isfinite(log.q_cmd).all(axis=1)
    if read.sum() < len(log.t) // 2:
        return {}
    t, x = m.trajectory.t, m.trajectory
    load = link_side(arm, x, by_stage(arm.effects, arm), None).load
    for effect in EFFECTS:
        for j, joint in enumerate(arm.joint_names):
            lead = effect.motor_lead(load[:, j])
            if lead is None:
                continue
            command = np.interp(t, log.t[read], log.q_cmd[read, j])
            error = command - np.interp(t, log.t, log.q[:, j])
            usable = np.isfinite(lead) & m.inside & (error != 0.0)
            if min(np.mean(usable & (lead > 0)), np.mean(usable & (lead < 0))) < LEAST_SHARE:
                continue
            columns = np.column_stack([_of_any_drive(m, command, load[:, j], j), lead])[usable]
            found = jackknifed(columns, error[usable], ((t[usable] - t[0]) / BLOCK).astype(int))
            if found is not None:
                followed[effect.name, joint] = found
    return followed


def _of_any_drive(m: Measurement, command: np.ndarray, load: np.ndarray, j: int) -> np.ndarray:
    """(N, k) columns that need no gap: every one of them may stand in the following error of a sound gear."""
    x = m.trajectory
    speed, tau = m.rate_of_change(command), m.tau[:, j]
    senses = [np.tanh(x.dq[:, j] / width) for width in SENSES]
    more = (speed, m.rate_of_change(speed), tau, m.rate_of_change(tau), load, load * np.abs(load))
    out = np.column_stack([np.ones(len(command)), x.dq[:, j], x.ddq[:, j], *more, *senses])
    return out / np.maximum(np.sqrt(np.mean(out**2, axis=0)), 1e-300)


def jackknifed(x: np.ndarray, y: np.ndarray, block: np.ndarray) -> Observed | None:
    """The last coefficient of y = x c, and its standard deviation when blocks of samples are left out in turn."""
    _, block = np.unique(block, return_inverse=True)
    count = int(block.max()) + 1
    if count < LEAST_BLOCKS:
        return None
    first = np.flatnonzero(np.diff(block, prepend=-1))
    xx = np.add.reduceat(x[:, :, None] * x[:, None, :], first, axis=0)
    xy = np.add.reduceat(x * y[:, None], first, axis=0)
    whole, right = xx.sum(axis=0), xy.sum(axis=0)
    ridge = 1e-9 * np.diag(np.diag(whole))
    value = np.linalg.solve(whole + ridge, right)[-1]
    without = np.linalg.solve(whole - xx + ridge, (right - xy)[:, :, None])[:, -1, 0]
    std = OPTIMISM * float(np.sqrt((count - 1) / count * np.sum((without - value) ** 2)))
    return Observed(float(value), std) if np.isfinite(value) and np.isfinite(std) and std > 0 else None
