"""How an emulated bus is reached from outside: one class a transport, all behind these five methods."""

from __future__ import annotations

from abc import ABC, abstractmethod

import can


class Port(ABC):
    """The adapter between an emulated bus and its host; one thread calls it."""

    @abstractmethod
    def open(self) -> None:
        """Be reachable; DeviceError where the address is taken."""

    @abstractmethod
    def receive(self, timeout: float, state: str, stalled: bool) -> list[can.Message]:
        """Frames that the host wants sent, waiting at most `timeout` s; `stalled` means that nothing is taken from the host."""

    @abstractmethod
    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        """Tell the host what became of its frame, where the transport does that."""

    @abstractmethod
    def deliver(self, messages: list[can.Message]) -> None:
        """Frames for the host."""

    @abstractmethod
    def unplug(self) -> None:
        """Pull the cable between host and adapter."""

    @abstractmethod
    def close(self) -> None:
        """Be gone; safe to call more than once."""
