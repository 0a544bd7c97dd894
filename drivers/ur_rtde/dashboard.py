"""What a controller reports besides RTDE: answers of the dashboard server or the Robot API. Nothing here changes the robot."""

from __future__ import annotations

import re
import socket
import time
from dataclasses import dataclass

from drivers.ur_rtde import robot_api
from sim.errors import DeviceError

PORT = 29999
TIMEOUT = 3.0  # s for each answer
LINE_MAX = 4096  # bytes
# what an answer may be before it is shown, compared, or made part of a folder's name
MODEL, SERIAL, PRINTABLE = r"UR[\w +-]*", r"\w+", r"[^\x00-\x1f\x7f-\x9f\ud800-\udfff]*"


@dataclass(frozen=True)
class ControllerInfo:
    """What the controller reports about itself; empty or None if its version does not answer the question.

    program is the name of the loaded program, if it is reported.
    """

    polyscope: str
    model: str = ""
    serial: str = ""
    remote: bool | None = None
    operational_mode: str = ""
    safety: str = ""
    program: str = ""


# question -> first version of CB3 and of e-Series that has it (client library of Universal Robots, dashboard_client_implementation_g5.cpp)
QUESTIONS = {
    "PolyscopeVersion": ((3, 0), (5, 0)),
    "programState": ((3, 0), (5, 0)),
    "safetymode": ((3, 0), (5, 0)),
    "get robot model": ((3, 12), (5, 6)),
    "get serial number": ((3, 12), (5, 6)),
    "get operational mode": (None, (5, 6)),
    "is in remote control": (None, (5, 6)),
}


def ask(host: str, *questions: str) -> list[str]:
    """One answer line per question; DeviceError if the server is not there or does not answer."""
    try:
        with socket.create_connection((host, PORT), timeout=TIMEOUT) as connection:
            _line(connection)  # greeting
            answers = []
            for question in questions:
                connection.sendall(question.encode() + b"\n")
                answers.append(_line(connection))
            return answers
    except (OSError, UnicodeDecodeError) as error:
        raise DeviceError(
            f"the dashboard server at {host}:{PORT} does not answer ({error}); enable it in Settings > Security > Services"
        ) from error


def _line(connection: socket.socket) -> str:
    """The next line of a server that speaks only when asked; TimeoutError if it is not complete within TIMEOUT."""
    line, end = b"", time.monotonic() + TIMEOUT
    while not line.endswith(b"\n"):
        connection.settimeout(max(0.001, end - time.monotonic()))
        more = connection.recv(4096)
        if not more:
            raise ConnectionResetError("the server closed the connection")
        line += more
        if time.monotonic() > end or len(line) > LINE_MAX:
            raise TimeoutError(f"no complete line within {TIMEOUT:g} s and {LINE_MAX} bytes")
    return line.decode().strip()


def questions_for(version: tuple[int, ...]) -> list[str]:
    """The questions that a dashboard server of this version answers; none on PolyScope X, which has no dashboard server."""
    if version[0] >= 10:
        return []
    column = 0 if version[0] == 3 else 1
    return [q for q, since in QUESTIONS.items() if (first := since[column]) is not None and version[:2] >= first]


def controller_info(host: str, version: tuple[int, ...], robot_api_port: int) -> ControllerInfo:
    """What a controller of this version reports about itself."""
    if version[0] >= 10:
        return of_robot_api(robot_api.answers(host, robot_api_port), version)
    questions = questions_for(version)
    answer = dict(zip(questions, ask(host, *questions), strict=True))
    polyscope = answer["PolyscopeVersion"]
    found = re.search(r"\d+(\.\d+)+", polyscope)
    remote = answer.get("is in remote control", "").lower()
    return ControllerInfo(
        found.group(0) if found else polyscope,
        model=_like(MODEL, answer.get("get robot model", "")),
        serial=_like(SERIAL, answer.get("get serial number", "")),
        remote={"true": True, "false": False}.get(remote),
        operational_mode=_like(r"MANUAL|AUTOMATIC|NONE", answer.get("get operational mode", "")),
        safety=answer["safetymode"].removeprefix("Safetymode:").strip(),
        program=_like(r"(?:STOPPED|PLAYING|PAUSED) (?!<unnamed>)(.*)", answer["programState"]),
    )


def of_robot_api(answer: dict[str, str], version: tuple[int, ...]) -> ControllerInfo:
    """What the Robot API's answers say; empty where one has another form than a name or number, which must not reach a terminal or path."""

    def of(what: str, pattern: str) -> str:
        return _like(pattern, answer.get(what, ""))

    return ControllerInfo(
        of("PolyScope", r"\d[\w.-]*") or ".".join(map(str, version[:3])),
        model=of("model", MODEL),
        serial=of("serial", SERIAL),
        remote={"REMOTE": True, "LOCAL": False}.get(of("control mode", PRINTABLE)),
        operational_mode=of("operational mode", PRINTABLE),
        safety=of("safety mode", PRINTABLE),
        program=of("program", PRINTABLE),
    )


def _like(pattern: str, answer: str) -> str:
    """The answer, or its group, if it has the documented form, else empty: an unknown question is answered with a sentence."""
    found = re.fullmatch(pattern, answer)
    return "" if found is None else found.group(found.lastindex or 0).strip()
