"""Connected devices: robots that answer on the network, and CAN adapters. Queries only; nothing is switched on or moved."""

from __future__ import annotations

import fcntl
import ipaddress
import re
import socket
import struct
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from drivers.ur_rtde import dashboard, family
from sim.errors import DeviceError

PATIENCE = 0.4  # s to connect within the local network
AT_ONCE = 64
MOST_HOSTS = 1024
_ADDRESS, _NETMASK = 0x8915, 0x891B  # SIOCGIFADDR and SIOCGIFNETMASK, netdevice(7)


@dataclass(frozen=True)
class Robot:
    """A UR controller that answered: its address, what it reports about itself, and the shipped arms that it may be."""

    host: str
    polyscope: str
    model: str
    serial: str
    arms: tuple[str, ...]


@dataclass(frozen=True)
class Adapter:
    """A CAN interface, or a serial port that may be a CAN adapter: the options of `calib servo scan`, and the system's label."""

    interface: str
    channel: str
    label: str


def own_networks() -> list[ipaddress.IPv4Network]:
    """Private IPv4 networks of this computer without loopback, each narrowed to at most 256 addresses around its own."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                address, mask = (
                    socket.inet_ntoa(fcntl.ioctl(probe.fileno(), code, request)[20:24]) for code in (_ADDRESS, _NETMASK)
                )
            except OSError:  # an interface without an IPv4 address
                continue
            network = ipaddress.IPv4Interface(f"{address}/{mask}").network
            if network.prefixlen < 24:
                network = ipaddress.IPv4Interface(f"{address}/24").network
            if network.is_private and not network.is_loopback and network not in found:
                found.append(network)
    return found


def robots(hosts: Iterable[str]) -> list[Robot]:
    """UR controllers among these hosts, found by their dashboard servers (PolyScope X has none: name its host in the cell file)."""
    addresses = list(hosts)[:MOST_HOSTS]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        found_robots = pool.map(_robot_at, addresses)
        return [found for found in found_robots if found is not None]


def _robot_at(host: str) -> Robot | None:
    try:
        socket.create_connection((host, dashboard.PORT), timeout=PATIENCE).close()
        (polyscope,) = dashboard.ask(host, "PolyscopeVersion")
        number = re.search(r"(\d+)\.(\d+)[.\d]*", polyscope)
        if number is None:
            return None
        version = (int(number[1]), int(number[2]))
        info = dashboard.controller_info(host, version, 0)
    except (OSError, DeviceError, UnicodeError):
        return None  # nothing there, or something else on that port
    return Robot(host, info.polyscope, info.model, info.serial, tuple(family.called(info.model, version[0])))


def can_adapters() -> list[Adapter]:
    """CAN interfaces that are up, and USB serial ports, some of which are CAN adapters."""
    import can
    from serial.tools.list_ports import comports

    found = [
        Adapter("socketcan", str(c["channel"]), "CAN interface of the system")
        for c in can.detect_available_configs("socketcan")
    ]
    ports = sorted((p for p in comports() if p.vid is not None), key=lambda p: str(p.device))
    return found + [Adapter("slcan", str(p.device), str(p.description or "USB serial port")) for p in ports]
