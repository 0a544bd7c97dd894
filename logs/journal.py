"""The file behind a running recording: new, append-only, space reserved ahead, synced to the disk by another thread.

After the first failed write nothing more is written. `failure` keeps the sentence, and every later call raises it again.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import threading
import zlib
from collections.abc import Sequence
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Header, McapRecord, Metadata, Schema

from logs.mcap_records import JOURNAL, MAGIC, SEAL, SEAL_TAG
from logs.schemas import FAILURE, RECORDING, SCHEMAS, TOPICS, UNITS
from sim.errors import DeviceError
from sim.file_lock import locked

AHEAD = 16 << 20
SYNC_PERIOD = 0.2  # s: what a power cut can lose
_KEEP_SIZE = 1
_SEAL_HEAD = bytes([SEAL]) + (8).to_bytes(8, "little") + SEAL_TAG


def record_bytes(record: McapRecord) -> bytes:
    """One record as the mcap library writes it."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def journal_head(metadata: dict[str, str], attachments: Sequence[Attachment] = ()) -> bytes:
    """Header, metadata (state open), attachments, schemas and channels: after the magic, a valid start of a file."""
    numbers = {kind: k for k, kind in enumerate(SCHEMAS, start=1)}
    records: list[McapRecord] = [Header(profile="ros2", library=JOURNAL)]
    records.append(Metadata(name=RECORDING, metadata={**metadata, "state": "open"}))
    records += attachments
    records += [Schema(id=numbers[kind], name=kind, encoding="ros2msg", data=text.encode()) for kind, text in SCHEMAS.items()]
    records += [
        Channel(id=k, topic=topic, message_encoding="cdr", metadata=UNITS[topic], schema_id=numbers[kind])
        for k, (topic, kind) in enumerate(TOPICS.items(), start=1)
    ]
    return b"".join(record_bytes(record) for record in records)


class Disk:
    """Calls to the operating system, in one place so that a test can make any of them fail."""

    def write(self, fd: int, data: bytes) -> int:
        return os.write(fd, data)

    def sync(self, fd: int) -> None:
        os.fdatasync(fd)

    def reserve(self, fd: int, start: int, size: int) -> None:
        """Reserve blocks for `size` bytes after `start` without growing the file; OSError where there is no room.

        posix_fallocate would grow the file, and zeros are not MCAP records; fallocate(2) can keep the size.
        """
        fallocate = getattr(ctypes.CDLL(None, use_errno=True), "fallocate", None)
        if fallocate is None:
            raise OSError(errno.EOPNOTSUPP, "no fallocate")
        off_t = ctypes.c_int64
        if fallocate(ctypes.c_int(fd), ctypes.c_int(_KEEP_SIZE), off_t(start), off_t(size)):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))

    def free(self, fd: int) -> int:
        """Bytes that an ordinary user can still write."""
        status = os.fstatvfs(fd)
        return status.f_bavail * status.f_frsize


class Journal:
    """`append(records)` is one write and a seal; a kill at any moment loses at most the sample that was being written."""

    def __init__(
        self, path: Path, metadata: dict[str, str], reserve: int = AHEAD, disk: Disk | None = None, attachments: Sequence[Attachment] = (),
        first: bytes = b"",
    ) -> None:  # fmt: skip
        """Create a new file at `path` with `first` after its head; reserve `reserve` bytes, and more before they run out."""
        self._prepare(path, reserve, disk)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DeviceError(f"{path.parent}: is not a folder and cannot be created ({error.strerror})") from error
        try:
            self._fd = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            raise DeviceError(f"{path}: exists already; recordings are never overwritten, give another name") from None
        except OSError as error:
            raise DeviceError(f"{path}: cannot be created ({error.strerror}); record into a writable folder") from error
        locked(self._fd)  # where the file system has no locks, readers leave the file as it is
        try:
            self._reserve(reserve)
            self._check()
            self._size = self.disk.write(self._fd, MAGIC)
            self.append(journal_head(metadata, attachments) + first)
        except (OSError, DeviceError) as error:
            os.close(self._fd)
            path.unlink()
            raise (
                error if isinstance(error, DeviceError) else DeviceError(f"{path}: cannot be written ({error.strerror})")
            ) from error
        self._begin()

    @classmethod
    def reopened(cls, path: Path, size: int) -> Journal:
        """Continue the journal of a program that is gone, cut to its first `size` bytes; the caller holds its lock."""
        journal = cls.__new__(cls)
        journal._prepare(path, AHEAD, None)
        try:
            journal._fd = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
            os.ftruncate(journal._fd, size)
        except OSError as error:
            raise DeviceError(f"{path}: cannot be written ({error.strerror}); recover it in a writable folder") from error
        journal._size = size
        journal._begin()
        return journal

    def _prepare(self, path: Path, reserve: int, disk: Disk | None) -> None:
        self.path, self.disk = path, disk or Disk()
        self._step = min(reserve, AHEAD)
        self.failure: str | None = None
        self.reserves = True
        self._reserved = self._size = 0

    def _begin(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._keep_synced, name="journal sync", daemon=True)
        self._thread.start()

    def lock(self) -> int:
        """A descriptor that keeps the file locked after `close`, until it is closed itself."""
        return os.dup(self._fd)

    def append(self, records: bytes) -> None:
        """Write `records` and their checksum at once; DeviceError from the first failure on."""
        data = records + _SEAL_HEAD + zlib.crc32(records).to_bytes(4, "little")
        if self.failure is None or self._size + len(data) <= self._reserved:
            try:
                written = self.disk.write(self._fd, data)
                if written != len(data):
                    raise OSError(errno.ENOSPC, f"{written} of {len(data)} bytes written")
                self._size += written
                if self._size + self._step // 2 > self._reserved:
                    self._reserve(self._step)
            except OSError as error:
                self._reserved = 0
                self._fail(error)
        self._check()

    def _reserve(self, size: int) -> None:
        """Reserve `size` more bytes; running out is a failure while there is still room to end the motion."""
        try:
            self.disk.reserve(self._fd, self._size, size)
            self._reserved = self._size + size
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL):
                self._fail(error)
                return
            self.reserves = False
            if self.disk.free(self._fd) < size:
                self._fail(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
                return
            self._reserved = self._size + size

    def _fail(self, error: OSError) -> None:
        if self.failure is None:
            self.failure = (
                f"{self.path}: cannot be written after byte {self._size} ({error.strerror}); nothing is recorded from here on; "
                "free space or use another disk, and record again"
            )

    def _note(self, failure: str) -> None:
        """Write the failure into the file, where there is room: a later reader must not take it for whole."""
        record = record_bytes(Metadata(name=FAILURE, metadata={"reason": failure}))
        with contextlib.suppress(OSError):
            os.write(self._fd, record + _SEAL_HEAD + zlib.crc32(record).to_bytes(4, "little"))

    def _check(self) -> None:
        if self.failure is not None:
            raise DeviceError(self.failure)

    def _keep_synced(self) -> None:
        while not self._stop.wait(SYNC_PERIOD):
            try:
                self.disk.sync(self._fd)
            except OSError as error:
                self._fail(error)
                return

    def close(self) -> None:
        """Sync and close; a failure is raised after the file is closed. Safe to call more than once."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        try:
            if self.failure is None:
                self.disk.sync(self._fd)
        except OSError as error:
            self._fail(error)
        try:
            os.ftruncate(self._fd, self._size)  # releases the reserved space and cuts off half a sample
        except OSError as error:
            self._fail(error)
        if self.failure is not None:
            self._note(self.failure)
        try:
            os.close(self._fd)
        except OSError as error:  # a network disk may report a failed write only now
            self._fail(error)
        self._check()
