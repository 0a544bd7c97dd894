"""A bounded ring of messages in shared memory: one process puts, another takes, neither ever waits for the other.

Each slot carries its number and a check sum, so that a taker never believes a slot that is not wholly written, whatever order the
processor makes stores visible in.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import zlib
from pathlib import Path

_COUNTER = struct.Struct("<Q")
_SLOT = struct.Struct("<QIII")  # number, bytes of this slot, slots that follow for the same message, check sum
_HEADER = 8192
_HEAD, _TAIL, _LOST = 0, 64, 128  # counters on cache lines of their own
_WORDS = {"ready": 1024, "failure": 2048, "end": 4096}  # places of short texts, each set once
_WORD_MAX = 1000


def shared_memory(size: int) -> int:
    """A descriptor of `size` bytes of memory without a name: it goes when the last process that holds it goes."""
    if hasattr(os, "memfd_create"):
        fd = os.memfd_create("arm-calib-ring", os.MFD_CLOEXEC)
    else:
        with tempfile.NamedTemporaryFile(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as file:
            fd = os.dup(file.fileno())
    os.ftruncate(fd, size)
    return fd


class Ring:
    """`put` returns False and counts a loss where the ring is full; `take` returns None where it is empty."""

    def __init__(self, fd: int, slots: int, slot_size: int) -> None:
        self.slots, self.slot_size = slots, slot_size
        self._memory = mmap.mmap(fd, self.size(slots, slot_size))
        self._room = slot_size - _SLOT.size

    @staticmethod
    def size(slots: int, slot_size: int) -> int:
        """Size of the shared memory."""
        return _HEADER + slots * slot_size

    @property
    def lost(self) -> int:
        """Messages that found no room."""
        return self._get(_LOST)

    def put(self, data: bytes) -> bool:
        """Hand over one message; never waits."""
        head = self._get(_HEAD)
        parts = [data[k : k + self._room] for k in range(0, len(data), self._room)] or [b""]
        if head + len(parts) - self._get(_TAIL) > self.slots:
            _COUNTER.pack_into(self._memory, _LOST, self._get(_LOST) + 1)
            return False
        for k, part in enumerate(parts):
            at = _HEADER + (head + k) % self.slots * self.slot_size
            self._memory[at + _SLOT.size : at + _SLOT.size + len(part)] = part
            follow = len(parts) - 1 - k
            _SLOT.pack_into(self._memory, at, head + k, len(part), follow, _sum(head + k, follow, part))
        _COUNTER.pack_into(self._memory, _HEAD, head + len(parts))
        return True

    def take(self) -> bytes | None:
        """The oldest message."""
        tail, head = self._get(_TAIL), self._get(_HEAD)
        parts = []
        while tail < head:
            at = _HEADER + tail % self.slots * self.slot_size
            number, size, follow, check = _SLOT.unpack_from(self._memory, at)
            part = self._memory[at + _SLOT.size : at + _SLOT.size + min(size, self._room)]
            if number != tail or _sum(number, follow, part) != check:
                return None
            parts.append(part)
            tail += 1
            if not follow:
                _COUNTER.pack_into(self._memory, _TAIL, tail)
                return b"".join(parts)
        return None

    def say(self, place: str, text: str) -> None:
        """Leave a short text for the other side, under one of the names ready, failure, end; the first one stays."""
        if self.said(place) is None:
            raw = text.encode("utf-8", errors="replace")[:_WORD_MAX]
            at = _WORDS[place]
            self._memory[at + 8 : at + 8 + len(raw)] = raw
            _COUNTER.pack_into(self._memory, at, len(raw) + 1)

    def said(self, place: str) -> str | None:
        """The text that was left, or None."""
        at = _WORDS[place]
        size = self._get(at)
        return None if not size else self._memory[at + 8 : at + 7 + size].decode("utf-8", errors="replace")

    def _get(self, at: int) -> int:
        return int(_COUNTER.unpack_from(self._memory, at)[0])


def _sum(number: int, follow: int, part: bytes) -> int:
    return zlib.crc32(part, zlib.crc32(_COUNTER.pack(number) + bytes([follow & 0xFF])))
