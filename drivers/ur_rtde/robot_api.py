"""PolyScope X's Robot API: the requests that change nothing.

Paths, keys and first versions as in the client library of Universal Robots (dashboard_client_implementation_x.cpp) and, for 10.10 and
older, its notes: before 10.11 only the program state could be requested. A path that a version does not have answers 404 and is left out.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import threading

BASE = "/universal-robots/robot-api"
TIMEOUT = 2.0  # s without a byte of an answer
WHOLE = 2.0  # times TIMEOUT, within which an answer must be complete
SIZE_MAX = 1 << 16  # bytes; the longest of these answers has a few hundred

# quantity -> path and the key of the answer
QUESTIONS = {
    "program state": ("/program/v1/state", "state"),
    "robot mode": ("/robotstate/v1/robotmode", "mode"),
    "safety mode": ("/robotstate/v1/safetymode", "mode"),
    "control mode": ("/system/v1/controlmode", "mode"),
    "operational mode": ("/system/v1/operationalmode", "mode"),
    "program": ("/program/v1/loaded", "name"),
    "model": ("/system/v1/information", "robotType"),
    "serial": ("/system/v1/information", "serialNumber"),
    "PolyScope": ("/versions/v1", "marketingVersion"),
}


def answers(host: str, port: int) -> dict[str, str]:
    """The controller's answer to each question; unanswered ones are left out, all of them if the service is off."""
    bodies: dict[str, dict[str, object]] = {}
    found = {}
    for what, (path, key) in QUESTIONS.items():
        if path not in bodies:
            try:
                bodies[path] = fetch(host, port, path)
            except OSError:
                break
        value = bodies[path].get(key)
        if isinstance(value, str):
            found[what] = value
    return found


def fetch(host: str, port: int, path: str) -> dict[str, object]:
    """The JSON object at a path; empty if there is none. OSError if nothing answers."""
    connection = http.client.HTTPConnection(host, port, timeout=TIMEOUT)
    connection.connect()
    end = threading.Timer(WHOLE * TIMEOUT, _shut, (connection.sock,))
    end.start()
    try:
        connection.request("GET", BASE + path, headers={"Accept": "application/json"})
        response = connection.getresponse()
        body = response.read(SIZE_MAX)
    except http.client.HTTPException:
        return {}
    finally:
        end.cancel()
        connection.close()
    if response.status != 200:
        return {}
    try:
        answer = json.loads(body)
    except (ValueError, RecursionError):
        return {}
    return answer if isinstance(answer, dict) else {}


def _shut(connection: socket.socket) -> None:
    """Shut down a connection that takes too long; its reader then finds the end of the stream."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
