"""RTDE frames: big-endian u16 size (header included), u8 kind, payload.

Universal Robots, "Real-Time Data Exchange (RTDE) Guide", protocol version 2.
"""

from __future__ import annotations

import struct

VERSION, CONTROLLER_VERSION, TEXT = ord("V"), ord("v"), ord("M")
OUTPUTS, INPUTS, START, PAUSE, DATA = ord("O"), ord("I"), ord("S"), ord("P"), ord("U")

# name of an RTDE type -> struct format and number of values
TYPES = {
    "BOOL": ("?", 1),
    "UINT8": ("B", 1),
    "UINT32": ("I", 1),
    "UINT64": ("Q", 1),
    "INT32": ("i", 1),
    "DOUBLE": ("d", 1),
    "VECTOR3D": ("3d", 3),
    "VECTOR6D": ("6d", 6),
    "VECTOR6INT32": ("6i", 6),
}


def frame(kind: int, payload: bytes) -> bytes:
    """One frame on the wire."""
    return struct.pack(">HB", 3 + len(payload), kind) + payload


class Malformed(Exception):
    """Bytes that are not an RTDE frame; a controller closes the connection."""


class FrameReader:
    """Splits a byte stream into frames."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """The frames that `data` completes, as (kind, payload)."""
        self._bytes += data
        found = []
        while len(self._bytes) >= 3:
            size, kind = struct.unpack_from(">HB", self._bytes)
            if size < 3:
                raise Malformed(f"a frame of {size} bytes is shorter than its header")
            if len(self._bytes) < size:
                break
            found.append((kind, bytes(self._bytes[3:size])))
            del self._bytes[:size]
        return found
