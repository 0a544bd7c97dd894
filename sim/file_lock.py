"""File locks that end with their process: whether a file's writer is alive, and which process uses a device."""

from __future__ import annotations

import fcntl
import hashlib
import os
from pathlib import Path
from typing import BinaryIO

from sim.errors import DeviceError

LOCKS = Path("/tmp")  # one place for all users and environments, so that every program looks for a lock in the same folder


def locked(stream: BinaryIO | int) -> bool | None:
    """Lock an open file, or its descriptor, while it is open: False if another process has it, None without lock support."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except BlockingIOError:
        return False
    except OSError:
        return None


def is_locked(file: Path) -> bool:
    """Whether the program that writes this file is alive; True also if that cannot be determined."""
    with file.open("rb") as stream:
        return locked(stream) is not True


def lock_device(what: str) -> BinaryIO:
    """Reserve `what`, a device by its address, against other instances of this software while the returned file is open.

    DeviceError names the process that has it. The lock is on a separate file, which holds the process number: a bus or a
    network address is not a file, and an editor may replace a file that stands for a device.
    """
    file = LOCKS / f"arm-calib-{hashlib.sha256(what.encode()).hexdigest()[:24]}.lock"
    try:
        stream = os.fdopen(_opened(file), "r+b", buffering=0)
    except OSError as error:
        raise DeviceError(
            f"{what}: its lock {file} cannot be opened ({error.strerror}); remove that file or make it writable"
        ) from error
    if not locked(stream):
        owner = stream.read(20).decode("ascii", "replace").strip()
        stream.close()
        pid = owner if owner.isascii() and owner.isdecimal() else ""
        raise DeviceError(
            f"{what}: another program is using it ({f'PID {pid}' if pid else f'which has {file} open'}); wait until it has ended. If it holds an "
            f"arm: support the arm, then kill -INT {pid or 'PID'}"
        )
    stream.truncate(0)
    stream.write(f"{os.getpid()}\n".encode())
    return stream


def _opened(file: Path) -> int:
    """Descriptor of the file, created for all users if it does not exist; symbolic links are not followed."""
    flags = os.O_RDWR | os.O_NOFOLLOW
    try:
        return os.open(file, flags)  # first without O_CREAT, which systems refuse for another user's file in a common folder
    except FileNotFoundError:
        pass
    try:
        descriptor = os.open(file, flags | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        return os.open(file, flags)
    os.fchmod(descriptor, 0o666)
    return descriptor
