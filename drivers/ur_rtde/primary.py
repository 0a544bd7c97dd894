"""The primary interface, receiving only: the kinematics and limits that the controller holds for its own arm.

Universal Robots, "Client Interfaces": a robot state message holds sub-packages, among them kinematics info (5) and configuration data (6),
which arrive on connecting. Layout as parsed by the maker's client library (kinematics_info.cpp, configuration_data.cpp). Safety data (10) begins with
the checksum of the safety configuration (a reply in the maker's forum, "Safety Checksum", topic 988; the document calls the sub-package internal).
"""

from __future__ import annotations

import socket
import struct
import time
from dataclasses import dataclass

import numpy as np

from sim.dh import DhRows
from sim.errors import DeviceError

PORTS = (30011, 30001)  # the first takes no commands; controllers before 3.4 and 5.0 have only the second
TIMEOUT = 3.0
PACKAGE_MAX = 1 << 16  # bytes; a robot state has some 1500
ROBOT_STATE, KINEMATICS, CONFIGURATION, SAFETY = 16, 5, 6, 10
HEADER = struct.Struct(">IB")
KINEMATICS_ROWS = struct.Struct(">6I24dI")
CONFIGURATION_ROWS = struct.Struct(">24d5d24d4i")
SAFETY_CHECKSUM = struct.Struct(">I")
JOINTS = 6


@dataclass(frozen=True)
class OwnArm:
    """What a controller reports about its arm: calibrated kinematics, position limits rad, maximum speed rad/s.

    checksum is the controller's own checksum of its kinematic calibration, as text. safety is that of its safety configuration, None if
    it sends none.
    """

    kinematics: DhRows
    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    checksum: str
    safety: int | None = None


def own_arm(host: str) -> OwnArm:
    """What the controller reports about its arm; DeviceError if it does not within a bounded time."""
    return parsed(parts(state(host)[HEADER.size :], host), host)


def state(host: str) -> bytes:
    """The first robot state message with kinematics and configuration, as received; DeviceError if none comes in a bounded time."""
    refusal: OSError | None = None
    for port in PORTS:
        try:
            with socket.create_connection((host, port), timeout=TIMEOUT) as connection:
                return _listened(connection, f"{host}:{port}")
        except OSError as error:
            refusal = error
    raise DeviceError(
        f"no primary interface at {host} ({refusal}); enable it in Settings > Security > Services, or do without the controller's own "
        "kinematics"
    )


def _listened(connection: socket.socket, where: str) -> bytes:
    buffer = b""
    end = time.monotonic() + TIMEOUT
    while True:
        connection.settimeout(max(0.01, end - time.monotonic()))
        data = connection.recv(65536)
        if not data or time.monotonic() > end:
            raise TimeoutError("it does not send its kinematics and configuration")
        buffer += data
        while len(buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(buffer)
            if not HEADER.size <= size <= PACKAGE_MAX:
                raise DeviceError(f"{where} sent a package of {size} bytes; is it a UR controller's primary interface?")
            if len(buffer) < size:
                break
            if kind == ROBOT_STATE and {KINEMATICS, CONFIGURATION} <= set(parts(buffer[HEADER.size : size], where)):
                return buffer[:size]
            buffer = buffer[size:]


def parts(state: bytes, where: str) -> dict[int, bytes]:
    """The sub-packages of a robot state by type; DeviceError if their lengths do not add up."""
    found, at = {}, 0
    while at < len(state):
        if at + HEADER.size > len(state):
            raise DeviceError(f"{where}: a sub-package is cut off")
        size, kind = HEADER.unpack_from(state, at)
        if size < HEADER.size or at + size > len(state):
            raise DeviceError(f"{where}: sub-package {kind} claims {size} of {len(state) - at} bytes")
        found[kind] = state[at + HEADER.size : at + size]
        at += size
    return found


def parsed(found: dict[int, bytes], where: str) -> OwnArm:
    """The arm that both sub-packages describe; fields that newer versions append are not read."""
    try:
        kinematics = KINEMATICS_ROWS.unpack_from(found[KINEMATICS])
        configuration = CONFIGURATION_ROWS.unpack_from(found[CONFIGURATION])
    except struct.error as error:
        raise DeviceError(f"{where}: kinematics or configuration is too short ({error}); this version is not known") from error
    theta, a, d, alpha = np.reshape(kinematics[6:30], (4, JOINTS))
    limits, motion = np.reshape(configuration[:12], (JOINTS, 2)), np.reshape(configuration[12:24], (JOINTS, 2))
    numbers = [theta, a, d, alpha, limits, motion]
    if not all(np.all(np.isfinite(x)) for x in numbers) or not (
        np.all(limits[:, 0] < limits[:, 1]) and np.all(motion[:, 0] > 0)
    ):
        raise DeviceError(f"{where}: kinematics or limits are not those of any arm; nothing was taken from them")
    return OwnArm(
        DhRows(theta, a, d, alpha), limits[:, 0].copy(), limits[:, 1].copy(), motion[:, 0].copy(),
        "-".join(f"{x:08x}" for x in kinematics[:6]), _safety(found.get(SAFETY, b"")),
    )  # fmt: skip


def _safety(part: bytes) -> int | None:
    return int(SAFETY_CHECKSUM.unpack_from(part)[0]) if len(part) >= SAFETY_CHECKSUM.size else None
