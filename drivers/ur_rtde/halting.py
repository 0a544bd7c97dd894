"""Stop a robot that another program commands: a program of our own ends the one that is playing, and brakes."""

from __future__ import annotations

import socket

from drivers.ur_rtde.commander import SCRIPT_PORT
from sim.errors import DeviceError

TIMEOUT = 0.5  # s to open the port that takes programs


def halt(host: str, deceleration: float) -> None:
    """stopj with `deceleration` rad/s^2; DeviceError if the controller does not take the program."""
    program = f"def halt():\n  stopj({float(deceleration)!r})\nend\n"
    try:
        with socket.create_connection((host, SCRIPT_PORT), timeout=TIMEOUT) as connection:
            connection.sendall(program.encode())
    except OSError as error:
        raise DeviceError(f"{host}:{SCRIPT_PORT} did not accept the stop ({error}); use the emergency stop") from error
