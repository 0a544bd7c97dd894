"""A motion of all joints: samples of position, velocity and acceleration on increasing instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.finite import real_array


@dataclass(frozen=True, slots=True)
class Trajectory:
    """q(t), dq(t), ddq(t) at N instants; between two samples the motion is the quintic through both ends.

    t    (N,) s, strictly increasing
    q    (N, n) rad
    dq   (N, n) rad/s
    ddq  (N, n) rad/s^2

    The arrays are copied and read-only. The same type serves a plan and a filtered measurement.
    Raises ValueError for wrong shapes, values that are not finite, or instants that do not increase.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray

    def __post_init__(self) -> None:
        t = real_array(self.t, "Trajectory.t")
        if t.ndim != 1 or len(t) < 2:
            raise ValueError(f"Trajectory.t has shape {t.shape}: a motion needs at least two instants in one dimension")
        arrays = {"t": t}
        for name in ("q", "dq", "ddq"):
            value = real_array(getattr(self, name), f"Trajectory.{name}")
            if value.ndim != 2 or value.shape[0] != len(t) or value.shape != np.shape(self.q):
                raise ValueError(f"Trajectory.{name} has shape {value.shape}: expected ({len(t)}, n) like q")
            arrays[name] = value
        for name, value in arrays.items():
            if not np.all(np.isfinite(value)):
                where = np.argwhere(~np.isfinite(value))[0].tolist()
                raise ValueError(f"Trajectory.{name}{where} is {value[tuple(where)]}: every sample must be finite")
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        step = np.diff(t)
        if not np.all(step > 0):
            k = int(np.argmin(step))
            raise ValueError(
                f"Trajectory.t goes from {t[k]:.9g} s to {t[k + 1]:.9g} s at sample {k + 1}: instants must increase"
            )

    def __len__(self) -> int:
        return len(self.t)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.q.shape[1]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.t[-1] - self.t[0])

    def scaled(self, speed: float) -> Trajectory:
        """The same path at `speed` times the speed: t/s, dq*s, ddq*s^2; needs 0 < s."""
        if not (np.isfinite(speed) and speed > 0):
            raise ValueError(f"speed factor is {speed}: it must be a finite number above zero")
        return Trajectory(self.t / speed, self.q, self.dq * speed, self.ddq * speed**2)
