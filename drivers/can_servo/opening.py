"""From the interface and channel of a cell to an open python-can bus."""

from __future__ import annotations

import os
import socket
from typing import Any

import can

from drivers.can_servo.damiao_box import DamiaoBox
from drivers.can_servo.lawicel import LawicelBus
from drivers.emulated_address import START, is_emulated
from sim.can_wiring import CanOptions
from sim.errors import ConfigError, DeviceError
from sim.resources import nearest

SERVER_TIME = 2.0  # s in which a socketcand server takes a connection
SHARED = ("socketcan", "socketcand", "virtual", "udp_multicast")  # several programs can share such a bus
SETS_NO_BITRATE = ("virtual", "socketcan", "socketcand", "udp_multicast")  # their bit rate is set outside python-can
SETS_NO_FD = ("socketcand",)  # python-can's client supports classical frames only
FD_PROTOCOLS = (can.CanProtocol.CAN_FD, can.CanProtocol.CAN_FD_NON_ISO)
REMEDY = "plug the adapter in, bring its interface up, and check interface, channel and bus in the cell file"
REMEDIES = {
    "gs_usb": 'on Linux the kernel drives such adapters, with CAN FD from 5.18 on: interface = "socketcan", channel = "can0"; elsewhere '
    'install "python-can[gs_usb]" (classical CAN only), and channel is the number of the adapter, counted from 0',
    "socketcan": "plug the adapter in, see its name with `ip link`, and bring it up: sudo ip link set can0 up type can bitrate 1000000 (for CAN FD "
    "with dbitrate 5000000 fd on)",
}
PCAN_CLOCK = 80_000_000  # Hz, of PEAK's CAN FD adapters


def address_of(options: CanOptions) -> str:
    """Address of a bus on this computer, whatever the cell file calls it; empty for a bus within this process."""
    if options.interface == "virtual":
        return ""
    device = os.path.realpath(options.channel.partition("@")[0])  # python-can takes the baud rate of a line behind an @
    if device.startswith("/dev/") and os.path.exists(device):
        return device
    server = [str(options.bus[key]) for key in ("host", "port") if key in options.bus]
    return " ".join([options.interface, options.channel, *server])


def opened(options: CanOptions) -> can.BusABC:
    """The bus that a cell names; DeviceError with the remedy if it cannot be opened."""
    where = f"{options.interface} {options.channel}"
    known = sorted({*can.VALID_INTERFACES, "damiao"})
    if options.interface not in known:
        raise ConfigError(
            f"interface {options.interface!r:.40}: python-can has no interface of that name; {nearest(options.interface[:40], known)}; for "
            f"another one install its python-can plugin. Candle-light adapters: {REMEDIES['gs_usb']}"
        )
    if options.interface == "socketcand":
        _require_server(options)
    try:
        bus = _made(options)
    # python-can's interfaces raise all of these, NotImplementedError for what an adapter cannot do
    except (can.CanError, OSError, ValueError, TypeError, NotImplementedError, ImportError) as error:
        remedy = START if is_emulated(options.model_dump()) else REMEDIES.get(options.interface, REMEDY)
        raise DeviceError(f"{where}: cannot be opened ({error}); {remedy}") from error
    if options.data_bitrate is not None and bus.protocol not in FD_PROTOCOLS:
        bus.shutdown()
        raise DeviceError(
            f"{where}: this interface does not carry CAN FD; use one that does (socketcan, pcan, kvaser, an slcan adapter with CANable 2 "
            "firmware), or set the drives to classical CAN and leave data_bitrate out"
        )
    return bus


def _made(options: CanOptions) -> can.BusABC:
    """python-can's bus, or our own where python-can has none, or one that blocks."""
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
    """DeviceError if no server listens: python-can would retry for ten seconds and log each of thousands of refusals."""
    host, port = options.bus.get("host"), options.bus.get("port")
    if not isinstance(host, str) or not isinstance(port, int) or isinstance(port, bool):
        raise ConfigError(
            f'socketcand {options.channel}: host = {host!r}, port = {port!r}; write bus = {{ host = "127.0.0.1", port = 29536 }} in the cell file'
        )
    try:
        socket.create_connection((host, port), timeout=SERVER_TIME).close()
    except (OSError, OverflowError, UnicodeError) as error:
        raise DeviceError(
            f"socketcand {options.channel}: no server at {host}:{port} ({error}); start socketcand there, or correct bus in the cell file"
        ) from error
