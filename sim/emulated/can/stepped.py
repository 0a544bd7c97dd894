"""A python-can bus in this process on a simulated clock: an emulated bus at the speed of the computer, exactly repeatable."""

from __future__ import annotations

from collections import deque
from typing import Any

import can
from can.bus import BusState

from sim.clock import SimulatedClock
from sim.emulated.can.bus import EmulatedBus

STEP = 0.0005  # s between checks for unsolicited frames and watchdogs


class SteppedBus(can.BusABC):
    """Only waiting for a frame advances the clock. Raises what a kernel's CAN socket raises."""

    def __init__(self, emulated: EmulatedBus, clock: SimulatedClock, **arguments: Any) -> None:
        super().__init__(channel="stepped", **arguments)
        self.emulated, self.clock = emulated, clock
        self._queue: deque[can.Message] = deque()
        emulated.poll(clock.now())  # discards what was on the wire before this controller listened
        self.channel_info = "emulated bus on a simulated clock"

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if "unplugged" in self.emulated.active:
            raise can.CanOperationError("no such device", error_code=19)
        if self.emulated.state == "off":
            raise can.CanOperationError("the controller is in the bus-off state", error_code=100)
        if not self.emulated.send(msg, self.clock.now()):
            raise can.CanOperationError("no buffer space available", error_code=105)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end = self.clock.now() + (timeout if timeout is not None else 1.0)
        while True:
            if "unplugged" in self.emulated.active:
                raise can.CanOperationError("no such device", error_code=19)
            self._queue.extend(self.emulated.poll(self.clock.now()))
            if self._queue:
                return self._queue.popleft()
            if self.clock.now() >= end:
                return None
            self.clock.sleep_until(min(end, self.emulated.next_frame(), self.clock.now() + STEP))

    @property
    def state(self) -> BusState:
        return {"active": BusState.ACTIVE, "passive": BusState.PASSIVE, "off": BusState.ERROR}[self.emulated.state]

    @state.setter
    def state(self, new_state: BusState) -> None:
        raise NotImplementedError("the state of the emulated controller is set by its faults")
