"""The least-time stop of every joint by itself, with bounded jerk and deceleration.

Each joint brings (dq, ddq) to (0, 0) in the least time with |ddq| <= p_max and |jerk| <= jerk_max. Let v_0 be the speed that
remains after ddq is first taken to zero, v = dq, J = jerk_max and p = min(p_max, sqrt(J v + ddq^2 / 2)). The stop is jerk -J
for (ddq + p)/J, then -p held, then jerk +J for p/J (signs for v_0 > 0). Ruckig computes the same profile; a test compares the
two. A joint that already decelerates harder than p_max continues to: p_max is a deceleration whose torque was found to be
available.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np


@dataclass(frozen=True)
class StopProfile:
    """Three phases of each joint's stop, in its direction of motion `sign`: all arrays (N, n).

    speed rad/s and acceleration rad/s^2 at the start, times sign; p rad/s^2: deceleration reached; t1 t2 t3 s: the phases.
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
        """Duration of each stop, (N, n) s."""
        return self.t1 + self.t2 + self.t3

    def rows(self, rows: slice) -> StopProfile:
        """The stops of some samples, (N', 1, n), ready to be evaluated at (N', M, 1) instants."""
        names = ("sign", "speed", "acceleration", "p", "t1", "t2", "t3")
        return replace(self, **{name: getattr(self, name)[rows, None] for name in names})

    def travel(self, t: np.ndarray) -> np.ndarray:
        """Angle travelled t s after the stop began, rad; constant once the joint is at rest."""
        return self.state(t)[0]

    def state(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angle travelled rad, speed rad/s and acceleration rad/s^2, t s after the stop began."""
        phases = (self.sign, self.speed, self.acceleration, self.p, self.t1, self.t2, self.t3, self.jerk_max)
        shape = np.broadcast_shapes(t.shape, *(x.shape for x in phases))
        found, cube = np.empty((3, *shape)), (-1, *shape[-2:])
        _states(*(np.broadcast_to(x, shape).reshape(cube) for x in (t, *phases)), found.reshape(3, *cube))
        return found[0], found[1], found[2]

    def extrema(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest angle travelled, (N, n) each: at the start, at the end, or where the joint reverses."""
        end = self.travel(self.duration)
        back = (self.speed < 0) & (self.acceleration > 0)
        root = np.sqrt(np.maximum(self.acceleration**2 + 2 * self.jerk_max * self.speed, 0))
        turn = self.travel(np.where(back, (self.acceleration - root) / self.jerk_max, 0.0))
        return np.minimum(np.minimum(end, turn), 0), np.maximum(np.maximum(end, turn), 0)


@numba.njit(cache=True)
def _states(t, sign, speed, acceleration, p, t1, t2, t3, jerk, out):  # type: ignore[no-untyped-def]
    """`StopProfile.state` of joints (N, M, n) into `out` (3, N, M, n)."""
    for i in np.ndindex(t.shape):
        a, j = acceleration[i], jerk[i]
        x, y, z = min(max(t[i], 0.0), t1[i]), min(max(t[i] - t1[i], 0.0), t2[i]), min(max(t[i] - t1[i] - t2[i], 0.0), t3[i])
        v1 = speed[i] + a * x - j * x * x / 2
        v2 = v1 - p[i] * y
        way = speed[i] * x + a * x * x / 2 - j * x * x * x / 6 + v1 * y - p[i] * y * y / 2
        moving = sign[i] if t[i] < t1[i] + t2[i] + t3[i] else 0.0
        out[0, i[0], i[1], i[2]] = sign[i] * (way + v2 * z - p[i] * z * z / 2 + j * z * z * z / 6)
        out[1, i[0], i[1], i[2]] = moving * (v2 - p[i] * z + j * z * z / 2)
        out[2, i[0], i[1], i[2]] = moving * (a - j * x if t[i] < t1[i] else j * z - p[i])


def stop_profile(dq: np.ndarray, ddq: np.ndarray, p_max: np.ndarray, jerk_max: np.ndarray) -> StopProfile:
    """The stop of each joint from dq (N, n) rad/s and ddq (N, n) rad/s^2, with a deceleration of at most p_max (n,) rad/s^2."""
    remaining = dq + ddq * np.abs(ddq) / (2 * jerk_max)
    sign = np.where(remaining >= 0, 1.0, -1.0)
    v, a = sign * dq, sign * ddq
    peak = np.sqrt(np.maximum(jerk_max * v + a**2 / 2, 0))
    p = np.minimum(peak, np.maximum(p_max, -a))
    with np.errstate(divide="ignore", invalid="ignore"):
        hold = np.where(peak > p, (v + (a**2 - 2 * p**2) / (2 * jerk_max)) / p, 0.0)
    return StopProfile(sign, v, a, p, np.maximum(a + p, 0) / jerk_max, np.maximum(hold, 0), p / jerk_max, jerk_max)
