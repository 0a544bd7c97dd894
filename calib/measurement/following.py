"""Effects between motor and link, as the following error (command minus reading) shows them.

A drive that closes its loop on the motor holds it at the command q_cmd, and the link lags by the lost motion of the gear:

    q_cmd - q = c X + b s(load) + e

X holds what any drive may add (1, speed and acceleration of link and command, torque and its rate, load and load |load|, sense
of motion). s is the effect's lead per unit of its parameter b (Effect.motor_lead), and e is correlated noise. b comes from
least squares, its standard deviation from leaving out one block of BLOCK seconds at a time. A drive that closes its loop on the
link shows nothing, so a following error without backlash is no evidence against backlash.

B. Efron, C. Stein (1981), doi:10.1214/aos/1176345462, for the jackknife.
"""

from __future__ import annotations

import numpy as np

from calib.measurement.observed import Key, Observed
from calib.measurement.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm
from sim.effects import EFFECTS, Stage, effect_named
from sim.prediction import torque_path

BLOCK = 1.0  # s
LEAST_BLOCKS = 8
LEAST_SHARE = 0.02  # of the samples, with a load of either sign
# s before and after a sign change of the load in which the motor may be anywhere in the gap: the crossing, the impact that ends
# it, and the error of the load. With them, 15 half gaps of the exam (seeds 26112951 to 26113001) came out 6 % too small in the
# median, without them 0.1 %.
CROSSING = (0.03, 0.1)
# Scatter of `value` over the jackknife's standard deviation where no effect is present. Set on 4373 pairs of joint and
# recording of the exam (seeds 26112811 to 26112841) and of other simulated arms.
OPTIMISM = 1.2
# rad/s over which the sense of motion reverses; chosen around the speeds at which dry friction of the exam's arms does
SENSES = (3e-3, 3e-2)


def observed(log: Log, m: Measurement, arm: Arm) -> dict[Key, Observed]:
    """Per effect and joint, the effect's only parameter as a recording shows it.

    Nothing where more than half of the commands are missing, where they equal the reading, or where the load keeps its sign.
    """
    followed: dict[Key, Observed] = {}
    read = np.isfinite(log.q_cmd).all(axis=1) & np.isfinite(log.q).all(axis=1)
    if 2 * read.sum() < len(log.t):
        return {}
    t, x = m.trajectory.t, m.trajectory
    command = _at(t, log.t[read], log.q_cmd[read])
    error = command - _at(t, log.t[read], log.q[read])
    load = torque_path(arm, x, [e for e in arm.effects if effect_named(e.effect).stage <= Stage.JOINT]).load
    for j, joint in enumerate(arm.joint_names):
        for effect in EFFECTS:
            lead = effect.motor_lead(load[:, j])
            if lead is None or not np.any(error[:, j]):
                continue
            usable = np.isfinite(lead) & m.inside & ~_crossing(t, load[:, j])
            if min(np.mean(usable & (lead > 0)), np.mean(usable & (lead < 0))) < LEAST_SHARE:
                continue
            columns = np.column_stack([_of_any_drive(m, command[:, j], load[:, j], j), lead])[usable]
            found = jackknifed(columns, error[usable, j], ((t[usable] - t[0]) / BLOCK).astype(int))
            if found is not None:
                followed[effect.name, joint] = found
    return followed


def _crossing(t: np.ndarray, load: np.ndarray) -> np.ndarray:
    """(N,) whether samples at t (N,) s lie near a sign change of load (N,)."""
    changes = t[1:][np.diff(np.sign(load)) != 0]
    before, after = CROSSING
    return np.searchsorted(changes, t + before, side="right") > np.searchsorted(changes, t - after, side="left")


def _at(t: np.ndarray, known: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(N, n) at t (N,) s: readings x (K, n) at instants `known` (K,), interpolated linearly."""
    return np.stack([np.interp(t, known, column) for column in x.T], axis=1)


def _of_any_drive(m: Measurement, command: np.ndarray, load: np.ndarray, j: int) -> np.ndarray:
    """(N, k) columns that the following error may contain without any backlash."""
    x = m.trajectory
    speed, tau = m.rate_of_change(command), m.tau[:, j]
    senses = [np.tanh(x.dq[:, j] / width) for width in SENSES]
    more = (speed, m.rate_of_change(speed), tau, m.rate_of_change(tau), load, load * np.abs(load))
    out = np.column_stack([np.ones(len(command)), x.dq[:, j], x.ddq[:, j], *more, *senses])
    return out / np.maximum(np.sqrt(np.mean(out**2, axis=0)), 1e-300)


def jackknifed(x: np.ndarray, y: np.ndarray, block: np.ndarray) -> Observed | None:
    """Last coefficient of y = x c and its standard deviation, blocks left out in turn; None with fewer than LEAST_BLOCKS."""
    _, block = np.unique(block, return_inverse=True)
    count = int(block.max()) + 1
    if count < LEAST_BLOCKS:
        return None
    first = np.flatnonzero(np.diff(block, prepend=-1))
    xx = np.add.reduceat(x[:, :, None] * x[:, None, :], first, axis=0)
    xy = np.add.reduceat(x * y[:, None], first, axis=0)
    whole, right = xx.sum(axis=0), xy.sum(axis=0)
    # a standing joint has columns of zeros
    ridge = 1e-9 * float(np.max(np.diag(whole))) * np.eye(len(whole))
    value = np.linalg.solve(whole + ridge, right)[-1]
    without = np.linalg.solve(whole - xx + ridge, (right - xy)[:, :, None])[:, -1, 0]
    std = OPTIMISM * float(np.sqrt((count - 1) / count * np.sum((without - value) ** 2)))
    return Observed(float(value), std) if np.isfinite(value) and np.isfinite(std) and std > 0 else None
