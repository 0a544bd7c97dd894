"""int w (tau - h) dt + int w' p dt = int w d dt: the torque d that the model does not explain, without any acceleration.

p = (M + I_a) dq is the momentum and h = g - C^T dq, so that dp/dt = tau - h - d. The observer of A. De Luca and R. Mattone (2003),
doi:10.1109/ROBOT.2003.1241998, weights the past by an exponential. Here the weight w is a triangle over two blocks of samples, which
keeps the balance exact for any sampling instants and makes the noise of neighbouring rows nearly white:

    d = (int w (tau - h) dt - (mean p of this block - mean p of the block before)) / int w dt

A body at the flange adds Y pi with pi = [m, m c, I] to the torque, so the same balance of its columns gives the row of the payload.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.watch.drive_torque import DriveTorque
from calib.watch.kernels import columns, half
from sim.arm import Arm
from sim.rigid_body import RigidBody

# step of the directional derivative of the momentum along the motion, s: 1e-5 of a radian at 1 rad/s
STEP = 1e-5
AROUND = STEP * np.array([[0.0], [1.0], [-1.0]])
SLIDING = 0.95
# torque of the model, direction of slip, speed, torque on the links, then [m, m c, I] of a body at the flange
COLUMNS = 14


@dataclass(frozen=True, slots=True)
class Row:
    """The balance over two blocks; t s, on the device clock, is that of the last sample.

    residual (n,) N m is the part that the model does not explain of torque (n,) N m on the links. payload (n, 10) is the regressor of
    [m, m c, I] of a body at the flange. slip (n,) and speed (n,) rad/s are means over the window, slowest (n,) rad/s is the least speed
    in it. sliding (n,): whether the joint slid one way throughout. seconds: duration of the last block.
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
    """Samples in, a row for every block of `length` samples; call `forget` after a gap, because no balance may span one."""

    def __init__(self, arm: Arm, gravity: np.ndarray | None = None, length: int = 10) -> None:
        self.drives = DriveTorque(arm)
        self._bodies = RigidBody(arm, gravity)
        self._weightless = RigidBody(arm, np.zeros(3))
        self._pi = self._bodies.parameters()
        self._still, self._speeds = np.zeros((2, 3, arm.n))
        self._since = np.nan
        # for every sample of the block, whose first is the last of the block before: t, motion, and the columns to integrate
        self._t, self._motion = np.empty(length + 1), np.empty((3, length + 1, arm.n))
        self._columns, self._momenta = np.empty((2, length + 1, arm.n, COLUMNS))
        self._gravity = np.empty((length + 1, arm.n))
        self.forget()

    def forget(self) -> None:
        """Start afresh: the next block has no predecessor."""
        self._before: _Half | None = None
        self._count = 0
        self.drives.forget()

    def add(self, t: float, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> Row | None:
        """Take one sample, t s, q dq tau (n,); return a row if it closes a block other than the first."""
        self._take(t, q, dq, tau)
        if self._count < len(self._t):
            return None
        here = self._half()
        before, self._before = self._before, here
        self._again()
        if before is None:
            return None
        weight = 0.5 * (before.seconds + here.seconds)
        mean = (before.rising + here.falling) / weight
        change = (here.momentum - before.momentum) / weight
        return Row(
            t=t, seconds=here.seconds, residual=mean[:, 3] - mean[:, 0] - change[:, 0], payload=mean[:, 4:] + change[:, 4:],
            torque=mean[:, 3], slip=mean[:, 1], speed=mean[:, 2], slowest=np.minimum(before.slowest, here.slowest),
            sliding=(before.sliding * here.sliding) > 0,
        )  # fmt: skip

    def _take(self, t: float, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> None:
        """Do the rigid-body work as each sample arrives, so that little remains for the sample that closes a block."""
        k = self._count
        if np.isnan(self._since):
            self._since = t
        self._t[k] = t
        self._motion[0, k], self._motion[1, k], self._motion[2, k] = q, dq, tau
        static = self._bodies.regressor(q, dq, self._still[0])
        # momentum here, and a little ahead and behind along the motion: its derivative at constant speed is (dM/dt) dq
        self._speeds[:] = dq
        around = self._weightless.regressor(q + AROUND * self._speeds, self._still, self._speeds)
        columns(
            static,
            around,
            self._pi,
            self.drives.rotor,
            self._motion[1, k],
            STEP,
            self._columns[k],
            self._momenta[k],
            self._gravity[k],
        )
        self._count += 1

    def _half(self) -> _Half:
        t, (q, dq, tau) = self._t, self._motion
        torque, slip = self.drives.link_torque(t - self._since, q, dq, tau, self._gravity)
        rising, falling, momentum = np.empty((3, *self._columns.shape[1:]))
        sliding, slowest = np.empty((2, dq.shape[1]))
        half(t, self._columns, self._momenta, torque, slip, dq, SLIDING, rising, falling, momentum, sliding, slowest)
        return _Half(float(t[-1] - t[0]), rising, falling, momentum, sliding, slowest)

    def _again(self) -> None:
        """The last sample of a block is the first of the next."""
        self._t[0], self._motion[:, 0] = self._t[-1], self._motion[:, -1]
        self._momenta[0], self._gravity[0] = self._momenta[-1], self._gravity[-1]
        self._columns[0] = self._columns[-1]
        self._count = 1
