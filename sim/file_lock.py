"""Whether a file's owner is alive, and who has a device: both by a lock that ends with its program, however that ends."""

from __future__ import annotations

import fcntl
import hashlib
import os
from pathlib import Path
from typing import BinaryIO

from sim.errors import DeviceError

LOCKS = Path("/tmp")  # one place for all users and environments: a lock that another program looks for elsewhere is none


def locked(stream: BinaryIO | int) -> bool | None:
    """Lock an open file, or its descriptor, for as long as it is open: False where another has it, None where the file system has no locks."""
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except BlockingIOError:
        return False
    except OSError:
        return None


def is_locked(file: Path) -> bool:
    """Whether the program that writes this run is alive, or nobody can know."""
    with file.open("rb") as stream:
        return locked(stream) is not True


def lock_device(what: str) -> BinaryIO:
    """Keep every other start of this software from `what`, a device by its address, for as long as the answer is open.

    DeviceError names the process that has it. The lock is on a file of its own, which holds that number: a bus and a network address are
    no files, and a file that stands for a device may be replaced by an editor.
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
            f"{what}: another program works with it ({f'PID {pid}' if pid else f'which has {file} open'}); wait until it has ended. Where it holds an "
            f"arm: support the arm, then kill -INT {pid or 'PID'}"
        )
    stream.truncate(0)
    stream.write(f"{os.getpid()}\n".encode())
    return stream


def _opened(file: Path) -> int:
    """A descriptor of the file, made for all users where it is not there yet; no link of somebody else's is followed."""
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
