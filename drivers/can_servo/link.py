"""The bus as the driver uses it: sending never waits, errors are counted, and once it has failed nothing more is sent."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from collections import deque
from collections.abc import Iterable
from typing import Any

import can
from can.bus import BusState

from drivers.can_servo.damiao_box import DamiaoBox
from drivers.can_servo.lawicel import LawicelBus
from sim.can_wiring import CanOptions
from sim.clock import Clock
from sim.errors import ConfigError, DeviceError
from sim.resources import nearest

FULL = {errno.ENOBUFS, errno.EAGAIN}
FULL_IN_ROW_MAX = 2  # refused frames one after another; one alone is a hiccup
ERROR_FRAMES_MAX, ERROR_FRAMES_WINDOW = 10, 1.0  # more in this time, s, is a bus that is not sound
SERVER_TIME = 2.0  # s in which a socketcand server takes a connection
CROWDED = 10.0  # s beyond its end after which a wait for frames ends although they go on coming
STATUS_PERIOD = 0.02  # s between two questions to a serial adapter
SETS_NO_BITRATE = ("virtual", "socketcan", "socketcand", "udp_multicast")  # their bit rate is set outside python-can
SETS_NO_FD = ("socketcand",)  # python-can's client of it knows classical frames only
FD_PROTOCOLS = (can.CanProtocol.CAN_FD, can.CanProtocol.CAN_FD_NON_ISO)
REMEDY = "plug the adapter in, bring its interface up, and check interface, channel and bus in the cell file"
REMEDIES = {
    "gs_usb": 'on Linux the kernel drives such adapters, with CAN FD from 5.18 on: interface = "socketcan", channel = "can0"; elsewhere '
    'install "python-can[gs_usb]" (classical CAN only), and channel is the number of the adapter, counted from 0',
    "socketcan": "plug the adapter in, see its name with `ip link`, and bring it up: sudo ip link set can0 up type can bitrate 1000000 (for CAN FD "
    "with dbitrate 5000000 fd on)",
}
PCAN_CLOCK = 80_000_000  # Hz, of PEAK's CAN FD adapters
CAN_ERR_BUSOFF, CAN_ERR_CRTL, PASSIVE_BITS = 0x40, 0x04, 0x30  # linux/can/error.h


class Link:
    """One python-can bus. `sent`, `received`, `refused`, `error_frames` count; `failed` says why it is over, or is empty."""

    def __init__(self, bus: can.BusABC, clock: Clock, where: str) -> None:
        self.bus, self.clock, self.where = bus, clock, where
        self.sent = self.received = self.refused = self.error_frames = 0
        self.failed = ""
        self._full_in_row = 0
        self._errors: deque[float] = deque()
        self._next_status = -float("inf")
        self._bells = 0

    @classmethod
    def open(cls, options: CanOptions, clock: Clock) -> Link:
        """The bus that a cell names; DeviceError with the remedy where it cannot be opened."""
        where = f"{options.interface} {options.channel}"
        known = sorted({*can.VALID_INTERFACES, "damiao"})
        if options.interface not in known:
            raise ConfigError(
                f"interface {options.interface!r:.40}: python-can has none of that name; {nearest(options.interface[:40], known)}; for "
                f"another one install its python-can plugin. Candle-light adapters: {REMEDIES['gs_usb']}"
            )
        if options.interface == "socketcand":
            _require_server(options)
        try:
            bus = _opened(options)
        # python-can's interfaces raise all of these, NotImplementedError for what an adapter lacks
        except (can.CanError, OSError, ValueError, TypeError, NotImplementedError, ImportError) as error:
            raise DeviceError(f"{where}: cannot be opened ({error}); {REMEDIES.get(options.interface, REMEDY)}") from error
        if options.data_bitrate is not None and bus.protocol not in FD_PROTOCOLS:
            bus.shutdown()
            raise DeviceError(
                f"{where}: this interface does not carry CAN FD; use one that does (socketcan, pcan, kvaser, an slcan adapter with CANable 2 "
                "firmware), or set the drives to classical CAN and leave data_bitrate out"
            )
        return cls(bus, clock, where)

    def send(self, messages: Iterable[can.Message]) -> list[can.Message]:
        """Put frames on the wire now or not at all; returns those that were accepted. DeviceError once the bus has failed."""
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
        """The next data frame, waiting until the instant `until`; None where none came. Error frames are evaluated here.

        What waits already is returned after `until` as well, but no longer than CROWDED: a crowded bus never runs empty.
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
        """End this link: drop what is queued, send nothing more. Returns the error to raise."""
        if not self.failed:
            self.failed = why
            self._abandon()
        return DeviceError(
            f"{self.where}: {why}; the drives switch themselves off after their timeout: mend it, then start again"
        )

    def close(self) -> None:
        """Give the bus back; safe to call more than once."""
        if not self.failed:
            self.failed = "it has been closed"
        with contextlib.suppress(can.CanError, OSError):
            self.bus.shutdown()

    def _require(self) -> None:
        if self.failed:
            raise DeviceError(f"{self.where}: nothing is sent, because {self.failed}; connect again")

    def _refuse(self) -> None:
        self.refused += 1
        self._full_in_row += 1
        if self._full_in_row >= FULL_IN_ROW_MAX:
            raise self.fail("the transmit queue is full: the bus does not take the frames, check cable and termination")

    def _look(self) -> None:
        """Bus state and refusals, as far as the interface reports them."""
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
            # Linger of zero throws away what the network has not taken yet, so that it cannot arrive late.
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        with contextlib.suppress(can.CanError, OSError):
            bus.shutdown()


def _opened(options: CanOptions) -> can.BusABC:
    """python-can's bus, or one of our own where python-can has none or one that waits."""
    if options.interface == "slcan":
        serial: dict[str, Any] = {"sleep_after_open": 0.0, **options.bus}
        return LawicelBus(options.channel, options.bitrate, options.data_bitrate, **serial)
    if options.interface == "damiao":
        return DamiaoBox(options.channel, options.bitrate, **options.bus)
    arguments: dict[str, Any] = {"channel": options.channel, "ignore_config": True}
    if options.interface == "gs_usb" and options.channel.isdecimal():
        arguments["index"] = int(options.channel)  # its channel is a name only
    if options.interface == "virtual":
        arguments["protocol"] = can.CanProtocol.CAN_20 if options.data_bitrate is None else can.CanProtocol.CAN_FD
    elif options.interface == "pcan" and options.data_bitrate is not None:
        arguments["timing"] = can.BitTimingFd.from_sample_point(PCAN_CLOCK, options.bitrate, 80.0, options.data_bitrate, 80.0)
    else:
        if options.interface not in SETS_NO_BITRATE:
            arguments["bitrate"] = options.bitrate
        if options.data_bitrate is not None and options.interface not in SETS_NO_FD:
            arguments["fd"] = True
            if options.interface not in SETS_NO_BITRATE:
                arguments["data_bitrate"] = options.data_bitrate
    return can.Bus(interface=options.interface, **(arguments | options.bus))


def _require_server(options: CanOptions) -> None:
    """DeviceError where nobody listens: python-can would try for ten seconds and log each of thousands of refusals."""
    host, port = options.bus.get("host"), options.bus.get("port")
    if not isinstance(host, str) or not isinstance(port, int) or isinstance(port, bool):
        raise ConfigError(
            f'socketcand {options.channel}: host = {host!r}, port = {port!r}; write bus = {{ host = "127.0.0.1", port = 29536 }} in the cell file'
        )
    try:
        socket.create_connection((host, port), timeout=SERVER_TIME).close()
    except (OSError, OverflowError) as error:
        raise DeviceError(
            f"socketcand {options.channel}: no server at {host}:{port} ({error}); start socketcand there, or correct bus in the cell file"
        ) from error
