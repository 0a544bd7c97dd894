"""The device's own stop from every instant of a motion, as a sheet of boxes (safety.sheets).

The last speed is held for the device's reaction time and this computer's worst latency. Then every joint decelerates at the
device's own rate, or all in proportion to the fastest (UR `stopj`: "leading axis"). If the torque may not suffice for that, the
deceleration lies anywhere from a share of it up to all of it.
"""

from __future__ import annotations

import numpy as np

from drivers.driver import DeviceStop
from safety.sheets import PARTS, STAGES, Boxes, Merged, check_range, hull, part_of
from sim.arm import Arm
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

# rad/s: a joint this slow stops at once, since friction suffices
CREEP = 1e-3
COASTING = 2


class DeviceStops(Merged):
    """The device's stop from every instant: row k holds those that begin between samples k and k + 1.

    The deceleration is anywhere from `share` of the device's own, for which the torque must suffice, to `hardest` of it.
    """

    def __init__(
        self, sent: Trajectory, arm: Arm, stop: DeviceStop, latency: float, share: float = 1.0, hardest: float = 1.0
    ) -> None:
        if not (np.isfinite(latency) and latency >= 0):
            raise SafetyStop(f"latency of this computer is {latency} s; it must be measured, finite and not negative")
        self._sent, self._arm, self._proportional = sent, arm, stop.proportional
        self._slow, self._fast = share * stop.deceleration, hardest * stop.deceleration
        self._softer = None if share == hardest else DeviceStops(sent, arm, stop, latency, share, share)
        self._coast = stop.reaction + latency
        h = np.diff(sent.t)[:, None]
        self._q = hull(np.stack((sent.q[:-1], sent.q[1:])), arm.ddq_max * h**2 / 8)
        self._dq = hull(np.stack((sent.dq[:-1], sent.dq[1:])), arm.jerk_max * h**2 / 8)
        apart = (self._dq[0] <= 0) & (self._dq[1] >= 0)
        self._least = np.where(apart, 0.0, np.minimum(np.abs(self._dq[0]), np.abs(self._dq[1])))
        self._most = np.maximum(np.abs(self._dq[0]), np.abs(self._dq[1]))
        self._brief, self._long = self._least / self._fast, self._most / self._slow
        if stop.proportional:
            self._brief, self._long = (
                np.broadcast_to(x.max(axis=2, keepdims=True), x.shape) for x in (self._brief, self._long)
            )
        self._braking = self._long.max(axis=(1, 2))
        self.duration = self._coast + self._braking
        coasting = np.linspace(0, self._coast, COASTING + 1)
        braking = np.linspace(0, 1, STAGES - COASTING + 1)[None] * self._braking[:, None]
        every = slice(None)
        first = self._coasting(every, coasting[None, :-1], coasting[None, 1:])
        then = self._slowing(every, braking[:, :-1], braking[:, 1:])
        self._merge(*(np.concatenate((a, b), axis=1) for a, b in zip(first, then, strict=True)))

    @property
    def softest(self) -> DeviceStops:
        """The stops at `share` alone. Not an attribute: a reference to itself keeps megabytes until garbage collection."""
        return self if self._softer is None else self._softer

    def _coasting(self, rows: slice, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, ...]:
        (q_lo, q_hi), (v_lo, v_hi) = ((x[rows] for x in pair) for pair in (self._q, self._dq))
        way = _product(v_lo, v_hi, begin[..., None], end[..., None])
        still = np.zeros_like(way[0])
        return q_lo + way[0], q_hi + way[1], v_lo + still, v_hi + still, still, still

    def _slowing(self, rows: slice, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, ...]:
        """From `begin` to `end` (R, P) s after braking began: angle and share of speed left grow with the braking time T."""
        (q_lo, q_hi), (v_lo, v_hi) = ((x[rows] for x in pair) for pair in (self._q, self._dq))
        u0, u1, brief, long = begin[..., None], end[..., None], self._brief[rows], self._long[rows]
        way = _product(v_lo, v_hi, self._coast + _held(u0, brief), self._coast + _held(u1, long))
        speed = _product(v_lo, v_hi, _left(u1, brief), _left(u0, long))
        least = np.full_like(brief, self._slow)
        most = np.full_like(brief, self._fast)
        if self._proportional:
            with np.errstate(divide="ignore", invalid="ignore"):
                least = np.where(long > 0, self._least[rows] / long, 0.0)
                most = np.where(brief > 0, np.minimum(most, self._most[rows] / brief), most)
        low = np.where((u1 < brief) & (self._most[rows] > CREEP), least, 0.0)
        high = np.where((u0 <= long) & (self._most[rows] > CREEP), most, 0.0)
        forward, backward = v_hi > 0, v_lo < 0
        a_lo = np.where(forward, -high, np.where(backward, low, 0.0))
        a_hi = np.where(backward, high, np.where(forward, -low, 0.0))
        both = forward & backward
        a_lo, a_hi = np.where(both, -high, a_lo), np.where(both, high, a_hi)
        return q_lo + way[0], q_hi + way[1], speed[0], speed[1], a_lo, a_hi

    def time(self, k: int) -> float:
        """Start of row k, s."""
        return float(self._sent.t[k])

    def refined(self, k: int, m: int) -> Boxes:
        """Parts of stage m of row k."""
        part, share = slice(k, k + 1), np.linspace(0, 1, PARTS + 1)[None]
        if m < COASTING:
            t = (m + share) / COASTING * self._coast
            return part_of(self._coasting(part, t[:, :-1], t[:, 1:]))
        t = (m - COASTING + share) / (STAGES - COASTING) * self._braking[k]
        return part_of(self._slowing(part, t[:, :-1], t[:, 1:]))

    def end(self) -> np.ndarray:
        """Largest angle (K, n) rad from the start of row k's stops to standstill."""
        return (self._most * (self._coast + self._long / 2))[:, 0]

    def check_limits(self) -> None:
        """SafetyStop unless every stop ends within q_min and q_max; a joint moves one way only, so its end is its extremum."""
        low, high = self.boxes.lo[:, :, 0].min(axis=1), self.boxes.hi[:, :, 0].max(axis=1)
        check_range(self._sent, low, high, self._arm, "the device's own stop")


def _product(
    v_lo: np.ndarray, v_hi: np.ndarray, f_lo: np.ndarray | float, f_hi: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of v f for v in [v_lo, v_hi] and f in [f_lo, f_hi], f not negative."""
    return np.minimum(v_lo * f_lo, v_lo * f_hi), np.maximum(v_hi * f_lo, v_hi * f_hi)


def _held(u: np.ndarray, braking: np.ndarray) -> np.ndarray:
    """u - u^2 / (2 T) until T, then T / 2: the travel of a joint that slows from speed 1 to 0 within T s."""
    u = np.minimum(u, braking)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(braking > 0, u - u**2 / (2 * braking), 0.0)


def _left(u: np.ndarray, braking: np.ndarray) -> np.ndarray:
    """1 - u / T until T, then 0: the remaining share of its speed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(braking > 0, np.clip(1 - u / braking, 0, 1), (u <= 0).astype(float))
