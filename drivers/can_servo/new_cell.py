"""The first cell file of a servo arm, from a scan and from joints turned by hand; what is still unknown is left as TODO."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import tomli_w

from drivers.can_servo.scan import Found
from sim.can_wiring import CanOptions

HEAD = """# Written by `calib servo scan`. Lines that begin with "# TODO" are yours; `calib check` names what is still missing.
"""
STIFFNESS = "# TODO kp = 0.0  # N m/rad\n# TODO kd = 0.0  # N m s/rad; without them the joint falls\n"
RANGES = "# TODO ranges = { q = 12.5, dq = 0.0, tau = 0.0 }  # rad, rad/s, N m from the manual of its model and firmware\n"
WATCHDOG = (
    "# TODO watchdog_endpoint = 0  # number of config.watchdog_timeout in the firmware's flat_endpoints.json; gear as well\n"
)


def cell_text(name: str, arm: str, options: CanOptions, joints: Mapping[str, tuple[Found, int]]) -> str:
    """A cell file, TOML: for each joint its drive and the sign of its direction. arm: as the file names it."""
    protocol = Counter(found.protocol for found, _ in joints.values()).most_common(1)[0][0]
    rest = [round(sign * found.described.q, 4) for found, sign in joints.values()]
    top: dict[str, Any] = {"schema": "cell/1", "name": name, "arm": arm, "driver": "can_servo"}
    text = HEAD + tomli_w.dumps(top)
    text += (
        "# the pose in which the arm was scanned: where it may lose its torque\n"
        if all(map(math.isfinite, rest))
        else "# TODO "
    )
    text += tomli_w.dumps({"rest": rest}, indent=0).replace("\n", " ").strip() + "\n\n"
    options_table: dict[str, Any] = {
        "interface": options.interface, "channel": options.channel, "bitrate": options.bitrate, "data_bitrate": options.data_bitrate,
        "bus": options.bus, "protocol": protocol, "rate": 200.0, "watchdog": 0.1, "brakes": False,
    }  # fmt: skip
    text += "[options]\n" + tomli_w.dumps({k: v for k, v in options_table.items() if v not in (None, {}) and k != "bus"})
    if options.bus:
        text += "bus = { " + ", ".join(tomli_w.dumps({k: v}).strip() for k, v in options.bus.items()) + " }\n"
    count = Counter(found.described.serial for found, _ in joints.values())
    unique, fast = {s for s, n in count.items() if s and n == 1}, options.data_bitrate is not None
    return text + "".join(_servo(joint, found, sign, protocol, fast, unique) for joint, (found, sign) in joints.items())


def _servo(joint: str, found: Found, sign: int, protocol: str, fast: bool, unique: set[str]) -> str:
    servo: dict[str, Any] = {"joint": joint, "node": found.node}
    if found.protocol != protocol:
        servo["protocol"] = found.protocol
    if found.protocol in ("damiao", "cubemars"):
        servo["feedback"] = found.feedback
    if found.fd != (found.protocol == "damiao" and fast):
        servo["fd"] = found.fd
    if found.described.serial in unique:
        servo["serial"] = found.described.serial
    servo["direction"] = sign
    text = "\n[[options.servos]]\n" + tomli_w.dumps(servo)
    if found.protocol == "odrive":
        return text + WATCHDOG
    return text + STIFFNESS + (RANGES if found.protocol in ("cubemars", "robstride") else "")
