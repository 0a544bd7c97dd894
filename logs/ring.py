"""A bounded ring of messages in shared memory: one process puts, another looks and lets go, and neither waits for the other.

Each slot carries its number and a checksum. So a partly written slot is never accepted, whatever the order in which the
processor makes stores visible.
"""

from __future__ import annotations

import mmap
import os
import re
import secrets
import stat
import struct
import zlib
from pathlib import Path

_COUNTER = struct.Struct("<Q")
_SLOT = struct.Struct("<QIII")  # number, bytes of this slot, slots that follow for the same message, checksum
_HEADER = 8192
_HEAD, _TAIL, _LOST = 0, 64, 128  # each counter on its own cache line
_SLOTS = 192  # place of the number of slots and of their size in bytes
_WORDS = {"ready": 1024, "failure": 2048, "host": 3200, "end": 4096}  # places of short texts, each set once
_WORD_MAX = 1000
_FOLDER = Path("/dev/shm")
_NAME = re.compile(r"arm-calib-[0-9a-f]{32}", re.ASCII)


def shared_memory(size: int) -> tuple[int, str]:
    """Return a descriptor of `size` bytes of shared memory, and its name; it outlives both processes until the next boot.

    The name is "" where no named memory is available. The memory is then released with the last process that holds it.
    """
    name = f"arm-calib-{secrets.token_hex(16)}"
    try:
        fd = os.open(_FOLDER / name, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except OSError:
        return _nameless(size), ""
    try:
        os.posix_fallocate(fd, 0, size)  # running out of room later would be a SIGBUS in the middle of a motion
    except OSError:
        os.close(fd)
        forget(name)
        return _nameless(size), ""
    return fd, name


def _nameless(size: int) -> int:
    fd = os.memfd_create("arm-calib-ring", os.MFD_CLOEXEC)
    os.ftruncate(fd, size)
    return fd


def forget(name: str) -> None:
    """Release the memory of that name, if there is any."""
    if _NAME.fullmatch(name):
        (_FOLDER / name).unlink(missing_ok=True)


def left_behind(name: str) -> Ring | None:
    """Return the ring of that name; None where there is none.

    The name comes from a file: the memory is accepted only where it can be a ring of this user.
    """
    if not _NAME.fullmatch(name):
        return None
    try:
        fd = os.open(_FOLDER / name, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        status = os.fstat(fd)
        if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid() or status.st_size < _HEADER:
            return None
        slots, slot = struct.unpack("<QQ", os.pread(fd, 16, _SLOTS))
        if not 0 < slots <= 1 << 20 or not _SLOT.size < slot <= 1 << 16 or Ring.size(slots, slot) != status.st_size:
            return None
        return Ring(fd, slots, slot)
    finally:
        os.close(fd)


class Ring:
    """A ring in which `put` returns False and counts a loss when it is full, and `look` returns None when it is empty.

    A message stays in the ring until `let_go`, so a reader that is killed in between loses nothing.
    """

    def __init__(self, fd: int, slots: int, slot_size: int) -> None:
        self.slots, self.slot_size = slots, slot_size
        self._after = 0
        self._memory = mmap.mmap(fd, self.size(slots, slot_size))
        self._words = memoryview(self._memory)[:_HEADER].cast("Q")
        self._room = slot_size - _SLOT.size
        struct.pack_into("<QQ", self._memory, _SLOTS, slots, slot_size)

    @staticmethod
    def size(slots: int, slot_size: int) -> int:
        """Size of the shared memory, bytes."""
        return _HEADER + slots * slot_size

    @property
    def lost(self) -> int:
        """Number of messages that found no room."""
        return self._get(_LOST)

    def put(self, data: bytes) -> bool:
        """Hand over one message; never waits."""
        head = self._get(_HEAD)
        parts = [data[k : k + self._room] for k in range(0, len(data), self._room)] or [b""]
        if head + len(parts) - self._get(_TAIL) > self.slots:
            self._set(_LOST, self._get(_LOST) + 1)
            return False
        for k, part in enumerate(parts):
            at = _HEADER + (head + k) % self.slots * self.slot_size
            self._memory[at + _SLOT.size : at + _SLOT.size + len(part)] = part
            follow = len(parts) - 1 - k
            _SLOT.pack_into(self._memory, at, head + k, len(part), follow, _sum(head + k, follow, part))
        self._set(_HEAD, head + len(parts))
        return True

    def look(self) -> bytes | None:
        """Return the oldest message, which stays in the ring."""
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
                self._after = tail
                return b"".join(parts)
        return None

    def let_go(self) -> None:
        """Release the message that was last looked at."""
        self._set(_TAIL, self._after)

    @property
    def waiting(self) -> int:
        """Number of slots that are filled and not released."""
        return self._get(_HEAD) - self._get(_TAIL)

    def set_note(self, place: str, text: str) -> None:
        """Leave a short text for the other side under ready, failure, host or end; the first one stays."""
        if self.note(place) is None:
            raw = text.encode("utf-8", errors="replace")[:_WORD_MAX]
            at = _WORDS[place]
            self._memory[at + 8 : at + 8 + len(raw)] = raw
            self._set(at, len(raw) + 1)

    def note(self, place: str) -> str | None:
        """The text left under that name, or None."""
        at = _WORDS[place]
        size = self._get(at)
        return None if not size else self._memory[at + 8 : at + 7 + size].decode("utf-8", errors="replace")

    def _get(self, at: int) -> int:
        return self._words[at // 8]

    def _set(self, at: int, value: int) -> None:
        """Store eight bytes at once: struct.pack_into clears them first, and a kill in between would leave a zero."""
        self._words[at // 8] = value


def _sum(number: int, follow: int, part: bytes) -> int:
    return zlib.crc32(part, zlib.crc32(_COUNTER.pack(number) + bytes([follow & 0xFF])))
