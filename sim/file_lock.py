"""Whether a file's owner is alive: it keeps the file locked for as long as it runs."""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import BinaryIO


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
