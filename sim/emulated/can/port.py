"""Access to an emulated bus from outside: one class per transport, all with the methods of Port."""

from __future__ import annotations

from abc import ABC, abstractmethod

import can


class Port(ABC):
    """The adapter between an emulated bus and its host; used by one thread at a time."""

    @abstractmethod
    def open(self) -> None:
        """Become reachable; DeviceError if the address is taken."""

    @abstractmethod
    def receive(self, timeout: float, state: str, stalled: bool) -> list[can.Message]:
        """Frames from the host, waiting at most `timeout` s; if `stalled`, nothing is taken from the host."""

    @abstractmethod
    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        """Report to the host whether its frame was accepted, if the transport does so."""

    @abstractmethod
    def deliver(self, messages: list[can.Message]) -> None:
        """Send frames to the host."""

    @abstractmethod
    def unplug(self) -> None:
        """Pull the cable between host and adapter."""

    @abstractmethod
    def close(self) -> None:
        """Close the adapter; safe to call more than once."""
