"""The bus as the driver uses it: sending never waits, errors are counted, and after a failure nothing more is sent."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from collections import deque
from collections.abc import Iterable
from typing import BinaryIO

import can
from can.bus import BusState

from drivers.can_servo.lawicel import LawicelBus
from drivers.can_servo.opening import SHARED, address_of, opened
from sim.can_wiring import CanOptions
from sim.clock import Clock
from sim.errors import DeviceError
from sim.file_lock import lock_device

FULL = {errno.ENOBUFS, errno.EAGAIN}
FULL_IN_ROW_MAX = 2  # refused frames in a row; a single one is harmless
ERROR_FRAMES_MAX, ERROR_FRAMES_WINDOW = 10, 1.0  # more within this time, s, are an unsound bus
CROWDED = 10.0  # s after its end at which a wait for frames is given up although frames keep coming
STATUS_PERIOD = 0.02  # s between two status requests to a serial adapter
CAN_ERR_BUSOFF, CAN_ERR_CRTL, PASSIVE_BITS = 0x40, 0x04, 0x30  # linux/can/error.h


class Link:
    """One python-can bus. `sent`, `received`, `refused`, `error_frames` count; `failed` is the reason of a failure, or empty."""

    def __init__(self, bus: can.BusABC, clock: Clock, where: str, address: str = "", claim: BinaryIO | None = None) -> None:
        self.bus, self.clock, self.where = bus, clock, where
        self._address, self._claim = address, claim
        self.sent = self.received = self.refused = self.error_frames = 0
        self.failed = ""
        self._full_in_row = 0
        self._errors: deque[float] = deque()
        self._next_status = -float("inf")
        self._bells = 0

    @classmethod
    def open(cls, options: CanOptions, clock: Clock) -> Link:
        """The bus that a cell names; DeviceError with the remedy if it cannot be opened, or another program of ours has it."""
        address = address_of(options)
        with contextlib.ExitStack() as undo:
            # such an adapter belongs to the program that opened it: a second open would close it while the first program holds an arm
            claim = None if options.interface in SHARED else undo.enter_context(lock_device(address))
            bus = opened(options)
            undo.pop_all()
        return cls(bus, clock, f"{options.interface} {options.channel}", address, claim)

    def claim(self, wait: bool = False) -> None:
        """Keep other programs of ours from commanding on this bus until `close`; DeviceError names the one that does.

        wait: no error, because a program that was killed may need a moment to end; the caller tries again.
        """
        if self._address and self._claim is None:
            with contextlib.suppress(*([DeviceError] if wait else [])):
                self._claim = lock_device(self._address)

    def recount(self) -> None:
        """Count sent and received frames from now: questions that a firmware does not know are no losses of the bus."""
        self.sent = self.received = 0

    def send(self, messages: Iterable[can.Message]) -> list[can.Message]:
        """Put frames on the wire now or not at all; return the accepted ones. DeviceError once the bus has failed."""
        self._require()
        accepted = []
        for message in messages:
            try:
                self.bus.send(message, timeout=0)
            except can.CanError as error:
                code = getattr(error, "error_code", None)
                if self.bus.state is BusState.ERROR:
                    raise self.fail("the controller is bus-off: cable, termination or bit rate") from error
                if code not in FULL and "buffer full" not in str(error) and not isinstance(error, can.CanTimeoutError):
                    raise self.fail(f"sending failed ({error})") from error
                self._refuse()
                continue
            except OSError as error:
                raise self.fail(f"sending failed ({error})") from error
            self._full_in_row = 0
            self.sent += 1
            accepted.append(message)
        return accepted

    def receive(self, until: float) -> can.Message | None:
        """The next data frame, waiting until the instant `until`; None if none has come. Error frames are evaluated here.

        Frames that already wait are returned after `until` too, but only until CROWDED s later: a crowded bus never runs empty.
        """
        self._require()
        while True:
            self._look()
            wait = until - self.clock.now()
            if wait < -CROWDED:
                return None
            try:
                message = self.bus.recv(max(0.0, wait))
            except (can.CanError, OSError, ValueError) as error:
                raise self.fail(f"receiving failed ({error}); is the adapter unplugged?") from error
            if message is None:
                return None
            if not message.is_error_frame:
                self.received += 1
                return message
            self._error_frame(message)

    def fail(self, why: str) -> DeviceError:
        """End this link: drop what is queued, send nothing more. Return the error to raise."""
        if not self.failed:
            self.failed = why
            self._abandon()
        return DeviceError(
            f"{self.where}: {why}; the drives switch themselves off after their timeout: fix it, then start again"
        )

    def close(self) -> None:
        """Release the bus; safe to call more than once."""
        if not self.failed:
            self.failed = "it has been closed"
        with contextlib.suppress(can.CanError, OSError):
            self.bus.shutdown()
        if self._claim is not None:
            self._claim.close()
            self._claim, self._address = None, ""

    def _require(self) -> None:
        if self.failed:
            raise DeviceError(f"{self.where}: nothing is sent, because {self.failed}; connect again")

    def _refuse(self) -> None:
        self.refused += 1
        self._full_in_row += 1
        if self._full_in_row >= FULL_IN_ROW_MAX:
            raise self.fail("the transmit queue is full: the bus does not take the frames, check cable and termination")

    def _look(self) -> None:
        """Check bus state and refusals, as far as the interface reports them."""
        bus = self.bus
        if isinstance(bus, LawicelBus):
            if bus.refused > self._bells:
                new, self._bells = bus.refused - self._bells, bus.refused
                self.refused += new
                self._full_in_row += new
                if self._full_in_row >= FULL_IN_ROW_MAX and bus.state is not BusState.ERROR:
                    raise self.fail("the transmit queue is full: the adapter refuses frames, check cable and termination")
            now = self.clock.now()
            if now >= self._next_status:
                self._next_status = now + STATUS_PERIOD
                with contextlib.suppress(can.CanError):
                    bus.ask_status()
        if bus.state is BusState.ERROR:
            raise self.fail("the controller is bus-off: cable, termination or bit rate")
        if bus.state is BusState.PASSIVE:
            raise self.fail("the controller is error-passive, one step before bus-off: cable, termination or bit rate")

    def _error_frame(self, message: can.Message) -> None:
        self.error_frames += 1
        identifier, data = message.arbitration_id, bytes(message.data)
        if identifier & CAN_ERR_BUSOFF:
            raise self.fail("the controller is bus-off: cable, termination or bit rate")
        if identifier & CAN_ERR_CRTL and len(data) > 1 and data[1] & PASSIVE_BITS:
            raise self.fail("the controller is error-passive, one step before bus-off: cable, termination or bit rate")
        now = self.clock.now()
        self._errors.append(now)
        while self._errors[0] < now - ERROR_FRAMES_WINDOW:
            self._errors.popleft()
        if len(self._errors) > ERROR_FRAMES_MAX:
            raise self.fail(
                f"{len(self._errors)} error frames within {ERROR_FRAMES_WINDOW:g} s: cable, termination or bit rate"
            )

    def _abandon(self) -> None:
        bus = self.bus
        if isinstance(bus, LawicelBus):
            bus.abandon()
        sock = getattr(bus, "_SocketCanDaemonBus__socket", None)
        if isinstance(sock, socket.socket):
            # A linger of zero discards what the network has not taken yet, so that it cannot arrive late.
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        with contextlib.suppress(can.CanError, OSError):
            bus.shutdown()
