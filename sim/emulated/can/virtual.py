"""The emulated bus on python-can's virtual bus: drives and driver in one process, on the wall clock."""

from __future__ import annotations

import can

from sim.emulated.can.port import Port


class VirtualPort(Port):
    """A member of the virtual channel."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self._bus: can.BusABC | None = None

    def open(self) -> None:
        self._bus = can.Bus(interface="virtual", channel=self.channel, ignore_config=True, protocol=can.CanProtocol.CAN_FD)

    def receive(self, timeout: float, state: str, stalled: bool) -> list[can.Message]:
        if self._bus is None or stalled:
            return []
        first = self._bus.recv(timeout)
        frames = [first] if first is not None else []
        while frames and (more := self._bus.recv(0)) is not None:
            frames.append(more)
        return frames

    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        """Nothing: the virtual bus does not acknowledge frames."""

    def deliver(self, messages: list[can.Message]) -> None:
        if self._bus is not None:
            for message in messages:
                self._bus.send(message)

    def unplug(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def close(self) -> None:
        self.unplug()
