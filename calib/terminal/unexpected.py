"""Unexpected errors: one sentence on the terminal, and a file with the details, which also holds the warnings of libraries."""

from __future__ import annotations

import logging
import platform
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sim.version import software_version

EXIT_CODE = 70  # EX_SOFTWARE of sysexits.h
MOST_COMPLAINTS = 200
COMPLAINTS: ContextVar[list[str] | None] = ContextVar("complaints", default=None)


class _Collector(logging.Handler):
    """Collects log records of libraries, which would go to standard error without a handler."""

    def __init__(self, kept: list[str]) -> None:
        super().__init__(logging.WARNING)
        self.kept = kept

    def emit(self, record: logging.LogRecord) -> None:
        if len(self.kept) < MOST_COMPLAINTS:
            self.kept.append(f"{record.name}: {record.getMessage()}")


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """While the block runs, warnings and log records of libraries are kept for `write_fault` instead of being printed."""
    kept: list[str] = []
    token = COMPLAINTS.set(kept)
    handler = _Collector(kept)
    logging.getLogger().addHandler(handler)

    def keep(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any, **__: Any) -> None:
        if len(kept) < MOST_COMPLAINTS:
            kept.append(f"{filename}:{lineno}: {category.__name__}: {message}")

    try:
        with warnings.catch_warnings():
            warnings.showwarning = keep
            yield
    finally:
        logging.getLogger().removeHandler(handler)
        COMPLAINTS.reset(token)


def write_fault(error: BaseException, arguments: Sequence[str], folders: Sequence[Path]) -> str:
    """Write the details of an unexpected error and return the sentence about it.

    The file is in the first run folder of this invocation, else in the working folder, else in the system's temporary folder.
    """
    now = datetime.now(UTC)
    what = type(error).__name__ + (f": {' '.join(str(error).split())}"[:200] if str(error) else "")
    text = "\n".join(
        [
            f"{now.isoformat(timespec='seconds')}  {software_version()}",
            f"Python {sys.version.split()[0]} on {platform.platform()}",
            f"in {_here()}: calib {' '.join(map(repr, arguments))}",
            "",
            "".join(traceback.format_exception(error)),
            "Warnings of libraries:",
            *(COMPLAINTS.get() or ["none"]),
            "",
        ]
    )
    name = f"calib-fault-{now:%Y%m%dT%H%M%S}.txt"
    for folder in (*folders[:1], Path(), Path(tempfile.gettempdir())):
        file = folder / name
        try:
            file.write_text(text, encoding="utf-8", errors="replace")
        except OSError:
            continue
        return f"this is a fault of the program, not yours ({what}); the details are in {file}: please report it with that file"
    return f"this is a fault of the program, not yours ({what}); the details could not be written to a file"


def _here() -> str:
    try:
        return str(Path.cwd())
    except OSError:
        return "a folder that no longer exists"
