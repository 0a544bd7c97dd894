"""Torque sent with each position: what the nominal arm needs, so that the drive's stiffness corrects only the rest."""

from __future__ import annotations

import numpy as np

from sim.arm import Arm
from sim.own_values import values_of
from sim.rigid_body import RigidBody


class Feedforward:
    """tau = M(q) ddq + C(q, dq) dq + g(q) of the nominal arm with its reflected inertia; kind "gravity" is g(q), "none" is zero.

    ddq is the difference of two commanded speeds per period. q, dq (n,) rad, rad/s -> (n,) N m.
    """

    def __init__(self, arm: Arm, kind: str, period: float) -> None:
        self._kind, self._period, self._n = kind, period, arm.n
        self._body = RigidBody(arm) if kind != "none" else None
        self._rotor = values_of(arm, "rotor_inertia", "inertia")
        self._last: tuple[float, np.ndarray] | None = None
        # compile here, where no drive waits for a command, rather than on the first command
        self(np.zeros(arm.n), np.zeros(arm.n), 0.0)
        self.hold(np.zeros(arm.n))
        self._last = None

    def __call__(self, q: np.ndarray, dq: np.ndarray, now: float) -> np.ndarray:
        """The torque for a moving target; after a pause the acceleration is taken as zero."""
        if self._body is None:
            return np.zeros(self._n)
        if self._kind == "gravity":
            return self.hold(q)
        ddq = np.zeros(self._n)
        if self._last is not None and now - self._last[0] < 3 * self._period:
            ddq = (dq - self._last[1]) / self._period
        self._last = (now, dq.copy())
        return self._body.inverse_dynamics(q[None], dq[None], ddq[None])[0] + self._rotor * ddq

    def hold(self, q: np.ndarray) -> np.ndarray:
        """The torque that holds the arm at q."""
        if self._body is None:
            return np.zeros(self._n)
        return self._body.gravity_torque(q[None])[0]
