"""From every sample that is sent, two stops: ours, jerk-limited, and the device's own when the link is lost.

Ours: each joint brings (dq, ddq) to (0, 0) in the least time with |ddq| <= ddq_max and |jerk| <= jerk_max. With v_0 the speed that
remains when ddq is taken to zero first, and p = min(ddq_max, sqrt(jerk_max v + ddq^2 / 2)), it is jerk -J for (ddq + p)/J, then
-p held, then jerk +J for p/J (signs for v_0 > 0). Ruckig computes the same profile while the arm moves; a test holds both equal.

The device's: the last speed is held for the device's reaction time and this computer's worst latency, then every joint slows down
with the device's deceleration, or all in proportion to the fastest (UR `stopj`: "leading axis").
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.driver import DeviceStop
from safety.limits import Pieces, pieces
from sim.arm import Arm
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

STAGES = 8
PARTS = 16
PATH_PARTS = 64
# s: a long piece, such as an approach has, is cut into parts no longer than this
PATH_STEP = 1e-3


class PathSheet:
    """The motion itself as boxes: one row a quintic piece, one column."""

    def __init__(self, motion: Trajectory) -> None:
        self._form: Pieces = pieces(motion)
        self.lo = self._form.q.min(axis=1)[:, None]
        self.hi = self._form.q.max(axis=1)[:, None]

    def time(self, k: int) -> float:
        """Beginning of piece k, s."""
        return float(self._form.t[min(k, len(self._form.t) - 1)])

    def refined(self, k: int, m: int) -> tuple[np.ndarray, np.ndarray]:
        """The piece in parts: ends of each part, widened by what speed can change between them."""
        b, h = self._form.q[k], float(self._form.t[k + 1] - self._form.t[k])
        parts = max(PATH_PARTS, int(np.ceil(h / PATH_STEP)))
        s = np.linspace(0, 1, parts + 1)[:, None, None]
        row = np.broadcast_to(b, (parts + 1, *b.shape))
        while row.shape[1] > 1:
            row = (1 - s) * row[:, :-1] + s * row[:, 1:]
        bulge = np.abs(self._form.ddq[k]).max(axis=0) * (h / parts) ** 2 / 8
        return _between(row[:, 0], bulge)


class OwnStops:
    """Our stop from every sample: row k is the stop that begins at sample k, column m its m-th share of time."""

    def __init__(self, motion: Trajectory, arm: Arm) -> None:
        self._motion, self._arm = motion, arm
        self.profile = stop_profile(motion.dq, motion.ddq, arm.ddq_max, arm.jerk_max)
        self.duration = self.profile.duration.max(axis=1)
        stage = self._nodes(slice(None), np.linspace(0, 1, STAGES + 1))
        bulge = arm.ddq_max * ((self.duration / STAGES) ** 2)[:, None, None] / 8
        self.lo = np.minimum(stage[:, :-1], stage[:, 1:]) - bulge
        self.hi = np.maximum(stage[:, :-1], stage[:, 1:]) + bulge

    def _nodes(self, rows: slice, share: np.ndarray) -> np.ndarray:
        t = self.duration[rows, None, None] * share[None, :, None]
        return self._motion.q[rows, None] + self.profile.rows(rows).travel(t)

    def time(self, k: int) -> float:
        """Instant at which stop k begins, s."""
        return float(self._motion.t[min(k, len(self._motion) - 1)])

    def refined(self, k: int, m: int) -> tuple[np.ndarray, np.ndarray]:
        """Stage m of stop k in parts."""
        share = (m + np.linspace(0, 1, PARTS + 1)) / STAGES
        bulge = self._arm.ddq_max * (float(self.duration[k]) / STAGES / PARTS) ** 2 / 8
        return _between(self._nodes(slice(k, k + 1), share)[0], bulge)

    def end(self) -> np.ndarray:
        """Angle (N, n) rad from the sample to standstill."""
        return self.profile.travel(self.profile.duration)

    def check_limits(self) -> None:
        """SafetyStop unless every stop stays within q_min and q_max; the extrema are exact."""
        low, high = self.profile.extrema()
        _check_range(self._motion, low, high, self._arm, "a stop")


class DeviceStops:
    """The device's stop from every sample; a stop that begins between two samples lies in the box of the earlier row."""

    def __init__(self, motion: Trajectory, arm: Arm, stop: DeviceStop, latency: float) -> None:
        if not (np.isfinite(latency) and latency >= 0):
            raise SafetyStop(f"latency of this computer is {latency} s; it must be measured, finite and not negative")
        self._motion, self._arm, self._stop = motion, arm, stop
        self._coast = stop.reaction + latency
        self._braking = np.abs(motion.dq) / stop.deceleration
        if stop.proportional:
            self._braking = np.broadcast_to(self._braking.max(axis=1, keepdims=True), motion.dq.shape)
        self.duration = self._coast + self._braking.max(axis=1)
        stage = self._nodes(np.arange(len(motion)), np.linspace(0, 1, STAGES + 1))
        bulge = stop.deceleration * ((self.duration / STAGES) ** 2)[:, None, None] / 8
        lo = np.minimum(stage[:, :-1], stage[:, 1:]) - bulge
        hi = np.maximum(stage[:, :-1], stage[:, 1:]) + bulge
        self.lo, self.hi = lo.copy(), hi.copy()
        self.lo[:-1] = np.minimum(lo[:-1], lo[1:])
        self.hi[:-1] = np.maximum(hi[:-1], hi[1:])

    def _nodes(self, rows: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Angles (R, M, n) at shares (M,) of each stop's time."""
        t = self.duration[rows, None, None] * share[None, :, None]
        braking, dq = self._braking[rows, None], self._motion.dq[rows, None]
        slowing = np.clip(t - self._coast, 0, braking)
        with np.errstate(divide="ignore", invalid="ignore"):
            lost = np.where(braking > 0, slowing**2 / (2 * braking), 0.0)
        return self._motion.q[rows, None] + dq * (np.minimum(t, self._coast) + slowing - lost)

    def time(self, k: int) -> float:
        """Instant at which stop k begins, s."""
        return float(self._motion.t[min(k, len(self._motion) - 1)])

    def refined(self, k: int, m: int) -> tuple[np.ndarray, np.ndarray]:
        """Stage m of stop k in parts, with those of the stop that begins at the next sample."""
        share = (m + np.linspace(0, 1, PARTS + 1)) / STAGES
        rows = np.array([k, min(k + 1, len(self._motion) - 1)])
        bulge = self._stop.deceleration * float(np.max(self.duration[rows]) / STAGES / PARTS) ** 2 / 8
        a, b = (_between(nodes, bulge) for nodes in self._nodes(rows, share))
        return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])

    def end(self) -> np.ndarray:
        """Angle (N, n) rad from the sample to standstill."""
        return self._motion.dq * (self._coast + self._braking / 2)

    def check_limits(self) -> None:
        """SafetyStop unless every stop ends within q_min and q_max; each joint moves one way only, so its end is its extremum."""
        end = self.end()
        _check_range(self._motion, np.minimum(end, 0), np.maximum(end, 0), self._arm, "the device's own stop")


def _between(nodes: np.ndarray, bulge: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Boxes around what lies between successive nodes (P+1, n): |x - chord| <= h^2/8 max|ddx|."""
    return np.minimum(nodes[:-1], nodes[1:]) - bulge, np.maximum(nodes[:-1], nodes[1:]) + bulge


def _check_range(motion: Trajectory, low: np.ndarray, high: np.ndarray, arm: Arm, what: str) -> None:
    low, high = motion.q + low, motion.q + high
    inside = (arm.q_min <= low) & (high <= arm.q_max)
    if not inside.all():
        k, j = np.argwhere(~inside)[0]
        raise SafetyStop(
            f"{arm.joint_names[j]}: {what} that begins at t={motion.t[k]:.4f} s with {motion.dq[k, j]:.4g} rad/s reaches "
            f"[{low[k, j]:.6g}, {high[k, j]:.6g}] rad, outside [{arm.q_min[j]:.6g}, {arm.q_max[j]:.6g}]; "
            "plan a slower motion or one further from the limit"
        )


@dataclass(frozen=True)
class StopProfile:
    """Three phases of each joint's stop, in the direction `sign` in which it moves: all arrays (N, n).

    speed rad/s and acceleration rad/s^2 at the start, times sign; p rad/s^2 the deceleration that is reached; t1 t2 t3 s.
    """

    sign: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    p: np.ndarray
    t1: np.ndarray
    t2: np.ndarray
    t3: np.ndarray
    jerk_max: np.ndarray

    @property
    def duration(self) -> np.ndarray:
        """(N, n) s."""
        return self.t1 + self.t2 + self.t3

    def rows(self, rows: slice) -> StopProfile:
        """The stops of some samples, (N', 1, n), ready to be evaluated at (N', M, 1) instants."""
        names = ("sign", "speed", "acceleration", "p", "t1", "t2", "t3")
        return replace(self, **{name: getattr(self, name)[rows, None] for name in names})

    def travel(self, t: np.ndarray) -> np.ndarray:
        """Angle travelled t s after the stop began, rad; constant once the joint stands."""
        j = self.jerk_max
        a = np.clip(t, 0, self.t1)
        b = np.clip(t - self.t1, 0, self.t2)
        c = np.clip(t - self.t1 - self.t2, 0, self.t3)
        v1 = self.speed + self.acceleration * a - j * a**2 / 2
        x = self.speed * a + self.acceleration * a**2 / 2 - j * a**3 / 6
        x = x + v1 * b - self.p * b**2 / 2
        v2 = v1 - self.p * b
        x = x + v2 * c - self.p * c**2 / 2 + j * c**3 / 6
        return self.sign * x

    def state(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angle travelled rad, speed rad/s and acceleration rad/s^2, t s after the stop began."""
        a, b = np.clip(t, 0, self.t1), np.clip(t - self.t1, 0, self.t2)
        c = np.clip(t - self.t1 - self.t2, 0, self.t3)
        j, moving = self.jerk_max, t < self.duration
        v = self.speed + self.acceleration * a - j * a**2 / 2 - self.p * (b + c) + j * c**2 / 2
        ddq = np.where(t < self.t1, self.acceleration - j * a, -self.p + j * c)
        return self.travel(t), self.sign * np.where(moving, v, 0.0), self.sign * np.where(moving, ddq, 0.0)

    def extrema(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest angle travelled, (N, n) each: at the start, at the end, or where the speed changes its sign."""
        end = self.travel(self.duration)
        back = (self.speed < 0) & (self.acceleration > 0)
        root = np.sqrt(np.maximum(self.acceleration**2 + 2 * self.jerk_max * self.speed, 0))
        turn = self.travel(np.where(back, (self.acceleration - root) / self.jerk_max, 0.0))
        return np.minimum(np.minimum(end, turn), 0), np.maximum(np.maximum(end, turn), 0)


def stop_profile(dq: np.ndarray, ddq: np.ndarray, ddq_max: np.ndarray, jerk_max: np.ndarray) -> StopProfile:
    """The stop of each joint from dq (N, n) rad/s and ddq (N, n) rad/s^2, |ddq| <= ddq_max."""
    remaining = dq + ddq * np.abs(ddq) / (2 * jerk_max)
    sign = np.where(remaining >= 0, 1.0, -1.0)
    v, a = sign * dq, sign * ddq
    peak = np.sqrt(np.maximum(jerk_max * v + a**2 / 2, 0))
    p = np.minimum(peak, ddq_max)
    with np.errstate(divide="ignore", invalid="ignore"):
        hold = np.where(peak > ddq_max, (v + (a**2 - 2 * p**2) / (2 * jerk_max)) / p, 0.0)
    return StopProfile(sign, v, a, p, np.maximum(a + p, 0) / jerk_max, np.maximum(hold, 0), p / jerk_max, jerk_max)
