"""From a fault until the arm is at rest: by the guard's own stop, or after the device was commanded to stop by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.driver import DeviceStop
from safety.stopping import Stop
from safety.trip import Standstill
from sim.joint_state import JointState, Status

STANDING_CYCLES = 5
REST_TIME = 2.0
# s into the stop after which the arm must be seen to slow down, otherwise the device is commanded to stop by itself
SLOWER_AFTER = 0.2


@dataclass(frozen=True)
class ComingToRest:
    """Brings one arm to rest at `rate` Hz. begin: the reading that showed the fault; good (n,) rad: position in the one before.

    noise (n,) rad/s: a joint no faster than that is at rest.
    """

    begin: JointState
    good: np.ndarray
    noise: np.ndarray
    rate: float

    def by_commands(
        self, stop: Stop, planned: np.ndarray, command: Callable[[np.ndarray, np.ndarray], None], read: Callable[[], JointState]
    ) -> Standstill:
        """Pass the samples of `stop` to `command` and wait until the arm is at rest; give up early if it does not slow down.

        planned (n,) rad/s: the last speed commanded before the stop.
        """
        fastest, at_begin = float(np.max(np.abs(planned))), float(np.max(np.abs(self.begin.dq), initial=0.0))
        still, state = 0, self.begin
        for i in range(len(stop.q) + round(REST_TIME * self.rate)):
            k = min(i, len(stop.q) - 1)
            dq = stop.dq[k] if i < len(stop.q) else np.zeros_like(stop.q[k])
            command(stop.q[k], dq)
            state = read()
            if state.status is not Status.RUNNING:
                break
            still = still + 1 if self._stands(state) else 0
            if i >= len(stop.q) - 1 and still >= STANDING_CYCLES:
                break
            slow = float(np.max(np.abs(dq))) < 0.5 * fastest
            if (i + 1) * stop.period > SLOWER_AFTER and slow and not float(np.max(np.abs(state.dq))) < at_begin:
                break
        return self._standstill(stop.kind, state, stop.q[-1] - self.good, still)

    def by_device(
        self, device: DeviceStop, q_cmd: np.ndarray, dq_cmd: np.ndarray, read: Callable[[], JointState], own: Standstill | None
    ) -> Standstill:
        """After the device was commanded to stop by itself: wait until the arm is at rest, for as long as that stop may take.

        q_cmd (n,) rad and dq_cmd (n,) rad/s: the last command. own: the preceding stop by commands, if any.
        """
        speed = float(np.max(np.abs(dq_cmd)))
        time = device.reaction + speed / device.deceleration
        angle = dq_cmd * (device.reaction + speed / (2 * device.deceleration))
        still, state = 0, self.begin
        for _ in range(round((time + REST_TIME) * self.rate)):
            try:
                latest = read()
                still = still + 1 if self._stands(latest) else 0
            except Exception:  # whatever a driver raises, the stop that was commanded is reported
                break
            state = latest
            if still >= STANDING_CYCLES:
                break
        kind = "the device's own stop" if own is None else f"{own.stop}, then the device's own stop"
        return self._standstill(kind, state, q_cmd + angle - self.good, still)

    def _stands(self, state: JointState) -> bool:
        return bool((np.abs(state.dq) <= self.noise).all())

    def _standstill(self, kind: str, end: JointState, angle: np.ndarray, still: int) -> Standstill:
        travelled = tuple((end.q - self.good).tolist()) if np.shape(end.q) == np.shape(self.good) else ()
        since = end.t_device - self.begin.t_device
        return Standstill(kind, since, travelled, tuple(angle.tolist()), still >= STANDING_CYCLES)
