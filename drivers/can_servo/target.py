"""The next command to the drives: a streamed target, or one that brakes along its path and then stands."""

from __future__ import annotations

from collections.abc import Sequence

import can
import numpy as np

from drivers.can_servo.drive import Drive
from drivers.can_servo.feedforward import Feedforward


class Target:
    """Last commanded q (n,) rad and dq (n,) rad/s, with one ready frame per drive in `frames`."""

    def __init__(self, drives: Sequence[Drive], feedforward: Feedforward, deceleration: float, step_max: float) -> None:
        self._drives, self._feedforward = drives, feedforward
        self._deceleration, self._step_max = deceleration, step_max
        self.q = self.dq = np.zeros(len(drives))
        self.frames: list[can.Message] = []
        self._braked_at: float | None = None

    @property
    def braking(self) -> bool:
        """Whether the target is braking, or stands after braking."""
        return self._braked_at is not None

    def follow(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray, now: float) -> np.ndarray:
        """Take a new target with extra torque tau (n,) N m; return the positions after quantisation. A refused one changes nothing."""
        torque = self._feedforward(q, dq, now) + tau
        made = [d.command(*x) for d, *x in zip(self._drives, q.tolist(), dq.tolist(), torque.tolist(), strict=True)]
        self.q, self.dq, self._braked_at = q.copy(), dq.copy(), None
        self.frames = [message for message, _ in made]
        return np.array([sent for _, sent in made])

    def stand(self, q: np.ndarray, now: float) -> None:
        """Stand at q (n,) rad, carried by the model's gravity torque."""
        self._aim(q, np.zeros(len(self._drives)))
        self._braked_at = now

    def brake(self, now: float) -> None:
        """Brake along the path: the fastest joint slows down at the deceleration, the others keep their ratio to its speed."""
        elapsed = 0.0 if self._braked_at is None else min(now - self._braked_at, self._step_max)
        self._braked_at = now
        fastest = float(np.max(np.abs(self.dq)))
        share = max(0.0, 1.0 - self._deceleration * elapsed / fastest) if fastest > 0 else 0.0
        moving = min(elapsed, fastest / self._deceleration)
        self._aim(self.q + self.dq * (1.0 + share) / 2 * moving, self.dq * share)

    def _aim(self, q: np.ndarray, dq: np.ndarray) -> None:
        torque = self._feedforward.hold(q)
        self.frames = [d.command(*x)[0] for d, *x in zip(self._drives, q.tolist(), dq.tolist(), torque.tolist(), strict=True)]
        self.q, self.dq = q.copy(), dq.copy()
