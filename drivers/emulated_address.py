"""Addresses and names that only emulated devices have (`calib emulate`).

A name alone is no proof: `safety.confirmation.without_arm`, by which a motion may begin without a person, also looks where a
link leads.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import Any

# Tunnels to a real controller usually end at this address; emulated controllers use 127.0.0.2 and the like
TUNNEL_END = ipaddress.IPv4Address("127.0.0.1")
# A tunnel to a serial adapter ends at a pseudo-terminal, as an emulated adapter does. Links to emulated ones have names that
# begin with this
EMULATED = "emulated"
# the remedy if such a device does not answer
START = "start `calib emulate CELL` in another terminal, in this folder"


def at_emulator(host: str) -> bool:
    """Whether only an emulated controller can have this address: an IPv4 loopback address other than TUNNEL_END."""
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError:  # a host name, localhost included, or IPv6, whose one loopback address is where tunnels end
        return False
    return address.is_loopback and address != TUNNEL_END


def is_emulated(options: Mapping[str, Any]) -> bool:
    """Whether `[options]` of a cell name an emulated controller, a CAN bus in memory, or the link that `calib emulate` makes."""
    host, channel = options.get("host"), options.get("channel")
    if isinstance(host, str):
        return at_emulator(host)
    return options.get("interface") == "virtual" or (isinstance(channel, str) and Path(channel).name.startswith(EMULATED))
