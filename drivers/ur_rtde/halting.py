"""A stop beside whatever commands the robot: a program of our own, which ends the one that plays and brakes."""

from __future__ import annotations

import socket

from drivers.ur_rtde.commander import SCRIPT_PORT
from sim.errors import DeviceError

TIMEOUT = 0.5  # s to open the port that takes programs


def halt(host: str, deceleration: float) -> None:
    """stopj with `deceleration` rad/s^2; DeviceError where the controller does not take the program."""
    program = f"def halt():\n  stopj({float(deceleration)!r})\nend\n"
    try:
        with socket.create_connection((host, SCRIPT_PORT), timeout=TIMEOUT) as connection:
            connection.sendall(program.encode())
    except OSError as error:
        raise DeviceError(f"{host}:{SCRIPT_PORT} took no stop ({error}); use the emergency stop") from error
