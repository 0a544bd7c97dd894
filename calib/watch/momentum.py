"""int w (tau - h) dt + int w' p dt = int w d dt: what the model leaves of the torque, without any acceleration.

p = (M + I_a) dq is the momentum and h = g - C^T dq, so that dp/dt = tau - h + (what the model lacks). The observer of A. De Luca and
R. Mattone (2003), doi:10.1109/ROBOT.2003.1241998, weighs the past by an exponential; here the weight w is a triangle over two
blocks of samples, which keeps the balance exact for any sampling instants and makes the noise of neighbouring rows nearly white:

    d = (int w (tau - h) dt - (mean p of this block - mean p of the block before)) / int w dt

A body at the flange adds Y pi with pi = [m, m c, I] to the torque, so the same balance of its columns gives the row of the payload.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.watch.drive_torque import DriveTorque
from calib.watch.kernels import block
from sim.arm import Arm
from sim.rigid_body import RigidBody

# step of the directional derivative of the momentum along the motion, s: 1e-5 of a radian at 1 rad/s
STEP = 1e-5
SLIDING = 0.95


@dataclass(frozen=True, slots=True)
class Row:
    """The balance over two blocks; t s on the device clock, of the last sample.

    residual (n,) N m that the model leaves of torque (n,) N m on the links; payload (n, 10) per [m, m c, I] of a body at the flange; slip (n,) and speed (n,) rad/s mean
    over the window; sliding (n,) whether the joint slid one way all the time; slowest (n,) rad/s in the window; seconds of the last block.
    """

    t: float
    seconds: float
    residual: np.ndarray
    torque: np.ndarray
    payload: np.ndarray
    slip: np.ndarray
    speed: np.ndarray
    slowest: np.ndarray
    sliding: np.ndarray


@dataclass(frozen=True, slots=True)
class _Half:
    """One block: its integrals under the rising and the falling side of the triangle, and its mean momentum."""

    seconds: float
    rising: np.ndarray
    falling: np.ndarray
    momentum: np.ndarray
    sliding: np.ndarray
    slowest: np.ndarray


class MomentumBalance:
    """Blocks of samples in, rows out; `forget` after a gap, because a balance never reaches across one."""

    def __init__(self, arm: Arm, gravity: np.ndarray | None = None) -> None:
        self.drives = DriveTorque(arm)
        self._bodies = RigidBody(arm, gravity)
        self._weightless = RigidBody(arm, np.zeros(3))
        self._pi = self._bodies.parameters()
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next block has no neighbour."""
        self._before: _Half | None = None
        self.drives.forget()

    def add(self, t: np.ndarray, since: float, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> Row | None:
        """A block of N >= 2 samples whose first is the last of the block before; t (N,) s, `since` the start; None for the first block."""
        here = self._half(t, since, q, dq, tau)
        before, self._before = self._before, here
        if before is None:
            return None
        weight = 0.5 * (before.seconds + here.seconds)
        mean = (before.rising + here.falling) / weight
        change = (here.momentum - before.momentum) / weight
        return Row(
            t=float(t[-1]), seconds=here.seconds, residual=mean[:, 0] - change[:, 0], payload=mean[:, 4:] + change[:, 4:],
            torque=mean[:, 3], slip=mean[:, 1], speed=mean[:, 2], slowest=np.minimum(before.slowest, here.slowest),
            sliding=(before.sliding * here.sliding) > 0,
        )  # fmt: skip

    def _half(self, t: np.ndarray, since: float, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> _Half:
        zero = np.zeros_like(q)
        static = self._bodies.regressor(q, dq, zero)
        # momentum here, and a little ahead and behind along the motion: its derivative at constant speed is (dM/dt) dq
        around = self._weightless.regressor(
            np.concatenate([q, q + STEP * dq, q - STEP * dq]), np.tile(zero, (3, 1)), np.tile(dq, (3, 1))
        )
        torque, slip, _ = self.drives.link_torque(t - since, q, dq, tau, static @ self._pi)
        rising, falling, momentum = np.empty((3, q.shape[1], 14))
        block(t, static, around, self._pi, self.drives.rotor, torque, slip, dq, STEP, rising, falling, momentum)
        direction = np.sign(slip[0])
        sliding = direction * np.all((direction * slip >= SLIDING) & (direction * dq > 0), axis=0)
        return _Half(float(t[-1] - t[0]), rising, falling, momentum, sliding, np.abs(dq).min(axis=0))
