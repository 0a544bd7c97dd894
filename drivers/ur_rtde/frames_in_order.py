"""The frames of a controller one after another: none is passed over while the arm moves, and none is read that is too old."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.receiver import Frame, Receiver
from sim.errors import DeviceError
from sim.joint_state import Status

PERIODS = 3.0
LISTEN_PATIENCE = 1.0  # s that a reading may wait for one who only listens: each one counts, none steers anything
REASON_TIME = 0.3  # s of readings in which the controller's own reason is looked for when the command process fails


class FramesInOrder:
    """`next` frame of a receiver; `last` is the one before. `running(frame)`: whether the controller reports no stop in it."""

    def __init__(self, receiver: Receiver, options: UrOptions, running: Callable[[Frame], bool]) -> None:
        self._receiver, self._options, self._running = receiver, options, running
        self._again: deque[Frame] = deque()
        self.last: Frame | None = None
        self.reason: str | None = None
        self.moving = self.listening = False

    def set_moving(self, moving: bool) -> None:
        """The arm moves from now on, or rests; a gap before it began to move is none."""
        if moving and not self.moving:
            self.last = None
        self.moving = moving

    def next(self) -> Frame:
        """The next frame in order. In motion an old one is an error; at rest those that waited for nobody are passed over."""
        if self._again:
            return self._again.popleft()
        host, longest = self._options.host, self._options.frame_timeout
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
            if not self.moving and waited > PERIODS / self._receiver.rate and self._receiver.waiting:
                continue
            gap = 0.0 if self.last is None else frame.t_device - self.last.t_device
            self.last = frame
            age = frame.age + waited
            late = age > longest or (gap > longest and self.moving)
            # what the controller reports of a stop is never too old to count
            if not late or not self._running(frame):
                return frame
            if self.moving:
                raise DeviceError(
                    f"{host}: the reading of {frame.t_device:.3f} s is {1e3 * age:.0f} ms old, {1e3 * gap:.0f} ms after "
                    f"the one before; at most {1e3 * longest:.0f} ms are allowed: use a wired connection of its own and stop "
                    "other work on this computer"
                )

    def newest(self) -> Frame:
        """The next frame behind which none waits."""
        frame = self.next()
        while self._receiver.waiting:
            frame = self.next()
        return frame

    def because(self, failure: DeviceError, condition: Callable[[Frame], tuple[Status, str]]) -> tuple[Frame, Status, str]:
        """The first frame in which the controller itself says what is wrong; `failure` where none does in REASON_TIME.

        The command process learns of a stop as early as this one does, and reports only that a command was not taken. Where it failed for
        a reason of its own, a program that ended is the consequence, and only safety and power say more.
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
