"""Controller frames in order: none is skipped while the arm moves, and none that is too old is returned."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.receiver import Frame, Receiver
from sim.errors import DeviceError
from sim.joint_state import Status

PERIODS = 3.0  # age, in periods, beyond which a reading at rest is skipped: a motion must start from a new one
PAUSE = 0.03  # s; before the first command, readings are skipped only after a longer pause of this computer
LISTEN_PATIENCE = 1.0  # s that a reading may wait when only listening: each one counts, none controls anything
REASON_TIME = 0.3  # s of frames searched for the controller's own reason when the command process fails


class FramesInOrder:
    """Frames of a receiver, one by one; `last` is the most recent. `running(frame)`: whether it reports no stop."""

    def __init__(self, receiver: Receiver, options: UrOptions, running: Callable[[Frame], bool]) -> None:
        self._receiver, self._options, self._running = receiver, options, running
        self._again: deque[Frame] = deque()
        self.last: Frame | None = None
        self.reason: str | None = None
        self.moving = self.listening = self._commanded = False

    def set_moving(self, moving: bool) -> None:
        """State whether the arm moves from now on, by commands. A gap before the start of a motion does not count."""
        self._commanded = True
        if moving and not self.moving:
            self.last = None
        self.moving = moving

    def next(self) -> Frame:
        """Next frame in order. In motion an old one is an error; at rest, old ones are skipped while newer ones wait."""
        if self._again:
            return self._again.popleft()
        host, longest = self._options.host, self._options.frame_timeout
        new = PERIODS / self._receiver.rate
        oldest = new if self._commanded else PAUSE
        deadline = time.monotonic() + longest
        while True:
            frame = self._receiver.next(deadline)
            if frame is None:
                raise DeviceError(
                    f"{host}: no new reading within {1e3 * longest:.0f} ms; see that the controller is on and the "
                    "cable is in; on a busy computer raise frame_timeout in the cell's [options]"
                )
            waited = time.monotonic() - frame.t
            if self.listening and waited <= LISTEN_PATIENCE:
                self.last = frame
                return frame
            if not self.moving and waited > oldest and self._receiver.waiting:
                oldest = new
                continue
            gap = 0.0 if self.last is None else frame.t_device - self.last.t_device
            self.last = frame
            age = frame.age + waited
            late = age > longest or (gap > longest and self.moving)
            # a stop that the controller reports counts, however old
            if not late or not self._running(frame):
                return frame
            if self.moving:
                raise DeviceError(
                    f"{host}: the reading of {frame.t_device:.3f} s is {1e3 * age:.0f} ms old, {1e3 * gap:.0f} ms after "
                    f"the one before; at most {1e3 * longest:.0f} ms are allowed: use a dedicated wired connection and stop "
                    "other work on this computer"
                )

    def newest(self) -> Frame:
        """The newest frame: the next one after which none waits."""
        frame = self.next()
        while self._receiver.waiting:
            frame = self.next()
        return frame

    def because(self, failure: DeviceError, condition: Callable[[Frame], tuple[Status, str]]) -> tuple[Frame, Status, str]:
        """The first frame in which the controller itself reports what is wrong, with status and detail.

        Raises `failure` if none does within REASON_TIME. The command process notices a stop as early as this one does, but reports only
        that a command was not taken. If it failed for a reason of its own, the ended program is a mere consequence, and only safety and
        power state explain more.
        """
        if self.reason is not None:
            raise DeviceError(self.reason) from failure
        end = time.monotonic() + REASON_TIME
        while (frame := self._receiver.next(end)) is not None:
            status, detail = condition(frame)
            if status is not Status.RUNNING:
                self._again.append(frame)
                self.reason = f"{self._options.host}: {status.value}: {detail}"
                return frame, status, detail
        self.reason = str(failure)
        raise failure
