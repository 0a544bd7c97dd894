"""RTDE frames, parsed defensively: any bytes give either frames or a BrokenStream.

Universal Robots, "Real-Time Data Exchange (RTDE) Guide", protocol version 2: u16 size with header, u8 kind, payload, big-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

HEADER = struct.Struct(">HB")
FRAME_MAX = 4096  # no recipe of this driver comes near it; a larger size is a broken stream

FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
PER_JOINT = frozenset({"actual_q", "actual_qd", "actual_current", "joint_temperatures"})


class BrokenStream(Exception):
    """The bytes are not an RTDE stream, or not the one agreed on; the message states where."""


def request(kind: str, payload: bytes = b"") -> bytes:
    """A frame to send."""
    return HEADER.pack(HEADER.size + len(payload), ord(kind)) + payload


class Splitter:
    """Cuts received bytes into frames (kind, payload)."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[tuple[str, bytes]]:
        """The frames that are now complete, in order; BrokenStream for a size that no frame has."""
        self._bytes += data
        frames = []
        while len(self._bytes) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._bytes)
            if not HEADER.size <= size <= FRAME_MAX:
                raise BrokenStream(f"a frame claims {size} bytes; RTDE frames here have {HEADER.size} to {FRAME_MAX}")
            if len(self._bytes) < size:
                break
            frames.append((chr(kind), bytes(self._bytes[HEADER.size : size])))
            del self._bytes[:size]
        return frames


@dataclass(frozen=True)
class Recipe:
    """The agreed layout of data frames: variable names and their types."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    def __post_init__(self) -> None:
        unknown = [t for t in self.types if t not in FORMATS]
        if unknown or len(self.types) != len(self.names):
            raise BrokenStream(f"{len(self.names)} variables were requested, the controller answered {', '.join(self.types)}")
        short = [n for n, t in zip(self.names, self.types, strict=True) if n in PER_JOINT and not FORMATS[t].startswith("6")]
        if short:
            raise BrokenStream(f"{', '.join(short)} must have a number for each of six joints")
        object.__setattr__(self, "_layout", struct.Struct(">B" + "".join(FORMATS[t] for t in self.types)))

    def unpack(self, payload: bytes) -> dict[str, tuple[float, ...]]:
        """The values of one data frame by variable name; BrokenStream if it is not of this layout."""
        layout: struct.Struct = self._layout  # type: ignore[attr-defined]
        if len(payload) != layout.size:
            raise BrokenStream(f"a data frame has {len(payload)} bytes, its recipe {layout.size}")
        number, *values = layout.unpack(payload)
        if number != self.number:
            raise BrokenStream(f"a data frame of recipe {number} came, recipe {self.number} was agreed on")
        found, at = {}, 0
        for name, type_ in zip(self.names, self.types, strict=True):
            count = int(FORMATS[type_][0]) if FORMATS[type_][0].isdigit() else 1
            found[name] = tuple(values[at : at + count])
            at += count
        return found
