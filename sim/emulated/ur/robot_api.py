"""The Robot API of PolyScope X: one HTTP request, one answer; only GET requests are emulated.

Paths, keys and first versions: client library of Universal Robots, dashboard_client_implementation_x.cpp (3.1.4 of the API is 10.12,
5.0.107 is 10.14). Mode names: SAFETY and ROBOT_MODES of the dashboard, which that library parses in the same way.
"""

from __future__ import annotations

import json
from typing import Any

from sim.emulated.ur.dashboard import PROGRAM, ROBOT_MODES, SAFETY

BASE = "/universal-robots/robot-api"
END = b"\r\n\r\n"


def answer(robot: Any, request: bytes) -> bytes:
    """The whole HTTP answer to one request."""
    words = request.split(b"\r\n", 1)[0].decode("ascii", "replace").split(" ")
    if len(words) != 3 or words[0] != "GET":
        return _response(405, {"message": "only GET requests are emulated"})
    content = _content(robot, words[1].removeprefix(BASE)) if words[1].startswith(BASE) else None
    return _response(404, {"message": "no such path"}) if content is None else _response(200, content)


def _content(robot: Any, path: str) -> dict[str, str] | None:
    version, program = robot.version, robot.program_name
    found: dict[str, str] | None = None
    if path == "/program/v1/state":
        found = {"state": PROGRAM[robot.runtime_state]}
    elif version >= (10, 12, 0):
        found = {
            "/robotstate/v1/robotmode": {"mode": ROBOT_MODES[robot.robot_mode]},
            "/robotstate/v1/safetymode": {"mode": SAFETY[robot.safety_mode]},
            "/system/v1/controlmode": {"mode": "REMOTE" if robot.remote else "LOCAL"},
            "/system/v1/operationalmode": {"mode": robot.operational_mode},
            **({"/program/v1/loaded": {"name": program}} if program else {}),
        }.get(path)
    if found is None and version >= (10, 14, 0):
        found = {
            "/system/v1/information": {"robotType": robot.model, "serialNumber": robot.serial},
            "/versions/v1": {"marketingVersion": ".".join(map(str, version))},
        }.get(path)
    return found


def _response(status: int, content: dict[str, str]) -> bytes:
    body = json.dumps(content).encode()
    head = f"HTTP/1.1 {status} \r\nContent-Type: application/json\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return head.encode() + body
