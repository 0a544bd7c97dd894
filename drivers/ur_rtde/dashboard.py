"""Questions to the dashboard server, each answered or refused within a bounded time. Nothing here changes the robot."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass

from sim.errors import DeviceError

PORT = 29999
TIMEOUT = 3.0


@dataclass(frozen=True)
class DashboardFacts:
    """What the dashboard says: PolyScope version, model and serial number (empty where it is too old to say), remote control."""

    polyscope: str
    model: str = ""
    serial: str = ""
    remote: bool | None = None


def ask(host: str, *questions: str) -> list[str]:
    """One answer line for each question; DeviceError where the server is not there or does not answer."""
    try:
        with (
            socket.create_connection((host, PORT), timeout=TIMEOUT) as connection,
            connection.makefile("rw", newline="\n") as line,
        ):
            line.readline()  # greeting
            answers = []
            for question in questions:
                line.write(question + "\n")
                line.flush()
                answer = line.readline()
                if not answer:
                    raise ConnectionResetError("the server closed the connection")
                answers.append(answer.strip())
            return answers
    except (OSError, UnicodeDecodeError) as error:
        raise DeviceError(
            f"the dashboard server at {host}:{PORT} does not answer ({error}); enable it in Settings > Security > Services"
        ) from error


def facts(host: str, version: tuple[int, ...]) -> DashboardFacts:
    """What the dashboard of a controller of this version can say; PolyScope X has none."""
    if version[0] >= 10:
        return DashboardFacts(".".join(map(str, version[:3])))
    polyscope = ask(host, "PolyscopeVersion")[0]
    found = re.search(r"\d+(\.\d+)+", polyscope)
    said = DashboardFacts(found.group(0) if found else polyscope)
    if version[:2] >= (5, 6):
        model, serial, remote = ask(host, "get robot model", "get serial number", "is in remote control")
        return DashboardFacts(said.polyscope, model, serial, remote.lower() == "true")
    return said
