"""Target of the joints in each cycle: held, servoed, moved, driven at a speed, or stopped."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

STANDSTILL = 1e-4  # rad/s


class Motion:
    """Target position q (n,) rad and speed dq (n,) rad/s, one step of dt s at a time."""

    def __init__(self, q: np.ndarray, dt: float) -> None:
        self.q = np.array(q, dtype=float)
        self.dq = np.zeros_like(self.q)
        self.ddq = np.zeros_like(self.q)
        self.dt = dt
        self._law: Callable[[], tuple[np.ndarray, np.ndarray]] = self._held

    def step(self) -> None:
        """Advance by dt."""
        q, dq = self._law()
        self.ddq = (dq - self.dq) / self.dt
        self.q, self.dq = q, dq

    @property
    def standing(self) -> bool:
        """Whether every joint is at rest."""
        return bool(np.all(np.abs(self.dq) < STANDSTILL))

    def servo(self, q_cmd: np.ndarray, lookahead: float, gain: float) -> None:
        """Follow q_cmd like a critically damped filter with delay = lookahead + 4.8/gain (s).

        The delay matches the 34 ms reported for lookahead 0.03 and gain 1200 (issue 86 of Universal_Robots_Client_Library);
        the form of the real filter is not published.
        """
        omega = 2.0 / (lookahead + 4.8 / gain)

        def law() -> tuple[np.ndarray, np.ndarray]:
            # exact for a command that is constant over dt, hence stable for any omega
            e, decay = self.q - q_cmd, np.exp(-omega * self.dt)
            slope = self.dq + omega * e
            return q_cmd + (e + slope * self.dt) * decay, (self.dq - omega * slope * self.dt) * decay

        self._law = law

    def speed(self, dq_cmd: np.ndarray, acceleration: float) -> None:
        """Approach dq_cmd with at most `acceleration`, rad/s^2."""

        def law() -> tuple[np.ndarray, np.ndarray]:
            dq = self.dq + np.clip(dq_cmd - self.dq, -acceleration * self.dt, acceleration * self.dt)
            return self.q + dq * self.dt, dq

        self._law = law

    def stop(self, deceleration: float) -> None:
        """Come to rest along the current direction, the fastest joint at `deceleration`, rad/s^2."""

        def law() -> tuple[np.ndarray, np.ndarray]:
            fastest = float(np.max(np.abs(self.dq)))
            left = max(0.0, fastest - deceleration * self.dt)
            dq = self.dq * (left / fastest) if fastest > STANDSTILL else np.zeros_like(self.dq)
            return self.q + dq * self.dt, dq

        self._law = law

    def move(self, q_end: np.ndarray, speed: float, acceleration: float, scale: Callable[[], float]) -> Callable[[], bool]:
        """Trapezoid to q_end, the leading joint at `speed` and `acceleration`, time scaled by `scale()`. Return a function: has it arrived?"""
        start, way = self.q.copy(), q_end - self.q
        length = float(np.max(np.abs(way)))
        if length < 1e-9:
            self.stop(acceleration)
            return lambda: True
        peak = min(speed, float(np.sqrt(acceleration * length)))
        ramp, total = peak / acceleration, length / peak + peak / acceleration
        clock = 0.0

        def law() -> tuple[np.ndarray, np.ndarray]:
            nonlocal clock
            clock = min(total, clock + self.dt * scale())
            if clock < ramp:
                s = 0.5 * acceleration * clock**2
            elif clock < total - ramp:
                s = peak * (clock - 0.5 * ramp)
            else:
                s = length - 0.5 * acceleration * (total - clock) ** 2
            q = start + way * (s / length)
            return q, (q - self.q) / self.dt

        self._law = law
        return lambda: clock >= total

    def _held(self) -> tuple[np.ndarray, np.ndarray]:
        return self.q, np.zeros_like(self.q)
