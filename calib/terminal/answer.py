"""Standard output that may be lost while the work goes on: its reader has gone (`| head`), its disk is full, or it was closed (`>&-`)."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

GONE = 141  # of a program that the signal PIPE ended, which a shell expects where the reader of an answer has gone


class StandardOutput(io.FileIO):
    """The file behind a standard output; the first error of writing is kept in `lost`, and what follows is dropped."""

    lost: OSError | None = None
    closed_from_start = False

    def write(self, data: Any) -> int | None:  # type: ignore[override]  # None is FileIO's own, of a pipe that would block
        """The number of bytes; never an error."""
        if self.closed_from_start:
            self.lost = OSError("it is closed")
        try:
            return super().write(data) if self.lost is None else memoryview(data).nbytes
        except OSError as error:
            self.lost = error
            return memoryview(data).nbytes


@contextmanager
def replaced() -> Iterator[None]:
    """While the block runs, standard output writes to an `StandardOutput`; after it nothing is left that Python could fail to flush at its end."""
    before = sys.stdout
    if before is sys.__stdout__:
        sys.stdout = _stream()
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stdout = before
        if sys.stderr is not None:
            try:
                sys.stderr.flush()
            except OSError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def lost() -> OSError | None:
    """Why standard output could not be written; None where it could."""
    sys.stdout.flush()
    return getattr(getattr(getattr(sys.stdout, "buffer", None), "raw", None), "lost", None)


def _stream() -> io.TextIOWrapper:
    own = sys.__stdout__
    if own is None:  # the lowest free number is then that of the standard output, which no file or process started here may get
        raw = StandardOutput(os.open(os.devnull, os.O_WRONLY), "w")
        raw.closed_from_start = True
        return io.TextIOWrapper(io.BufferedWriter(raw))
    raw = StandardOutput(own.fileno(), "w", closefd=False)
    return io.TextIOWrapper(io.BufferedWriter(raw), own.encoding, own.errors, line_buffering=own.isatty())
