"""Do the readings agree with each other? A sensor that goes on talking but no longer measures is found by what it should agree with.

speed       what a joint turned within SPAN s against the integral of its reported speed; found within SPAN s
frozen      a torque that repeats its last digit while the expected one moves; found within SPAN s of motion
torque      over SWING s, a torque that hardly moves where the expected one swings further than all that is not known; found within SWING s
clock       the device's clock against the host's: the earliest arrival of each BLOCK s, which no delay makes earlier; a rate that is
            off by 0.2 % is found within 4 s
"""

from __future__ import annotations

import numpy as np

from safety.trip import Trip
from sim.arm import Arm
from sim.joint_state import JointState

SPAN = 0.25
# s by which a reported speed may lag behind (a drive's filter), and what it may be off by all the time, share of dq_max
LAG = 0.02
BIAS = 0.01
SIGMAS = 6.0
# standard deviations of its noise by which the expected torque must have moved for a still one to be frozen
CHANGED = 3.0
SWING = 1.0
# of the swing that must be seen, the share that is
FOLLOWS = 0.25
BLOCK = 1.0
# quartz clocks are within 100 parts in a million of each other (IEC 60679-1 classes); what a busy computer delays is seldom missed in a block
DRIFT = 5e-4
JITTER = 3e-3


class Readings:
    """The rules for one run; `check` after every reading, in order."""

    def __init__(self, arm: Arm, rate: float, first: JointState, has_torque: np.ndarray) -> None:
        n, self._arm, self._rate = arm.n, arm, rate
        self._noise = np.array(arm.sensors.torque_noise)
        self._has_torque = has_torque
        self._moving = np.maximum(0.02, 8 * np.array(arm.sensors.velocity_noise))
        rows = max(4, round(SPAN * rate))
        # one row a reading of the last SPAN s: angle, speed, what the speed adds up to, instant
        self._ring, self._rows, self._count = np.zeros((rows, 3, n)), rows, 0
        self._t, self._last = np.zeros(rows), first
        self._turned = np.zeros(n)
        self._allowed = (
            10 * arm.sensors.encoder_resolution + 1e-4 + SPAN * BIAS * arm.dq_max
            + SIGMAS * np.array(arm.sensors.velocity_noise) * SPAN / np.sqrt(rows)
        )  # fmt: skip
        self._same, self._last_torque = np.zeros(n, dtype=int), np.full(n, np.nan)
        self._began, self._moved = np.zeros(n), np.zeros(n)
        self._swing_rows = max(8, round(SWING * rate))
        self._clear_swing()
        self._block_end, self._block_least = first.t_device + BLOCK, np.inf
        self._clock_origin: tuple[float, float] | None = None

    def pause(self) -> None:
        """Nobody need have read since the last reading: what spans the gap is not compared."""
        self._count = 0
        self._same[:] = 0
        self._clear_swing()

    def _clear_swing(self) -> None:
        n = self._arm.n
        self._seen, self._lo, self._hi = 0, np.full((2, n), np.inf), np.full((2, n), -np.inf)
        self._doubt = np.zeros(n)

    def check(self, state: JointState, torque: np.ndarray, tau_hat: np.ndarray | None, doubt: np.ndarray | None) -> Trip | None:
        """The first rule that is broken, or None. torque (n,) N m as read; tau_hat and doubt (n,) N m as expected, None where nothing is."""
        return (
            self._check_speed(state)
            or self._check_frozen(state, torque, tau_hat)
            or self._check_swing(torque, tau_hat, doubt)
            or self._check_clock(state)
        )

    def _check_speed(self, state: JointState) -> Trip | None:
        row = self._count % self._rows
        if self._count:
            step = state.t_device - self._last.t_device
            self._turned = self._turned + (state.dq + self._last.dq) * (step / 2)
        if self._count >= self._rows:
            q, dq, turned = self._ring[row]
            way = state.q - q
            off = np.abs(way - (self._turned - turned))
            fastest = np.maximum(np.maximum(np.abs(state.dq), np.abs(dq)), np.abs(way) / (state.t_device - self._t[row]))
            allowed = self._allowed + 2 * LAG * fastest
            if not (off <= allowed).all():
                return self._trip(
                    f"turned within {SPAN:g} s against the reported speed", ~(off <= allowed), off, allowed, "rad",
                    "the speed that the device reports is not that of its encoder: check sensor, unit and sign",
                )  # fmt: skip
        self._ring[row], self._t[row] = (state.q, state.dq, self._turned), state.t_device
        self._last = state
        self._count += 1
        return None

    def _check_frozen(self, state: JointState, torque: np.ndarray, tau_hat: np.ndarray | None) -> Trip | None:
        same = (torque == self._last_torque) & (np.abs(state.dq) > self._moving) & self._has_torque & (self._noise > 0)
        expected = np.zeros(self._arm.n) if tau_hat is None else tau_hat
        # a coarse reading may well stay as it is while nothing of the motion changes it
        self._began = np.where(same, self._began, expected)
        self._moved = np.where(same, np.maximum(self._moved, np.abs(expected - self._began)), 0.0)
        self._same = (self._same + 1) * same
        self._last_torque = torque
        fine = (self._same < self._rows) | (self._moved <= CHANGED * self._noise)
        if not fine.all():
            return self._trip(
                "readings with the very same torque in motion", ~fine, self._same.astype(float),
                np.full(self._arm.n, float(self._rows)), "", "the torque is frozen: check the drive's current sensor",
            )  # fmt: skip
        return None

    def _check_swing(self, torque: np.ndarray, tau_hat: np.ndarray | None, doubt: np.ndarray | None) -> Trip | None:
        if tau_hat is None or doubt is None or not self._has_torque.any():
            self._clear_swing()
            return None
        both = np.stack((tau_hat, torque))
        self._lo, self._hi = np.minimum(self._lo, both), np.maximum(self._hi, both)
        self._doubt = np.maximum(self._doubt, doubt)
        self._seen += 1
        if self._seen < self._swing_rows:
            return None
        wanted, found = self._hi - self._lo
        # the same wrong mass at both ends of the swing: what is certain of it is the swing less twice the doubt
        certain = wanted - 2 * self._doubt - 2 * SIGMAS * self._noise
        fine = ~self._has_torque | (certain <= 0) | (found >= FOLLOWS * certain)
        self._clear_swing()
        if not fine.all():
            return self._trip(
                f"swing of the torque within {SWING:g} s, for one of {float(certain[int(np.argmin(fine))]):.4g} N m that the motion takes,",
                ~fine, found, FOLLOWS * certain, "N m", "the torque does not follow the motion: check the sensor",
            )  # fmt: skip
        return None

    def _check_clock(self, state: JointState) -> Trip | None:
        self._block_least = min(self._block_least, state.t - state.t_device)
        if state.t_device < self._block_end:
            return None
        least, self._block_least, self._block_end = self._block_least, np.inf, state.t_device + BLOCK
        if self._clock_origin is None:
            self._clock_origin = state.t_device, least
            return None
        begin, origin = self._clock_origin
        off, allowed = abs(least - origin), DRIFT * (state.t_device - begin) + JITTER
        if not off <= allowed:
            return Trip(
                "the device's clock against this computer's,", off, allowed, "s",
                "one of the clocks runs at a wrong rate or jumped: check time synchronisation, and the rate that the device states",
            )  # fmt: skip
        return None

    def _trip(self, quantity: str, broken: np.ndarray, value: np.ndarray, limit: np.ndarray, unit: str, remedy: str) -> Trip:
        j = int(np.argmax(broken))
        return Trip(quantity, float(value[j]), float(limit[j]), unit, remedy, self._arm.joint_names[j])
