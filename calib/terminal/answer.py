"""Standard output that may fail while the command continues: its reader has gone (`| head`), its disk is full, or it was closed (`>&-`)."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

GONE = 141  # exit code after the signal PIPE, which a shell expects if the reader of the output has gone


class StandardOutput(io.FileIO):
    """The file behind standard output; the first write error is kept in `lost`, and later output is dropped."""

    lost: OSError | None = None
    closed_from_start = False

    def write(self, data: Any) -> int | None:  # type: ignore[override]  # None is FileIO's own, of a pipe that would block
        """Write, and return the number of bytes; write errors are not raised."""
        if self.closed_from_start:
            self.lost = OSError("it is closed")
        try:
            return super().write(data) if self.lost is None else memoryview(data).nbytes
        except OSError as error:
            self.lost = error
            return memoryview(data).nbytes


@contextmanager
def replaced() -> Iterator[None]:
    """While the block runs, standard output writes to a `StandardOutput`; afterwards everything is flushed, so Python's flush at exit cannot fail."""
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
    """The error of writing standard output; None if there was none."""
    sys.stdout.flush()
    return getattr(getattr(getattr(sys.stdout, "buffer", None), "raw", None), "lost", None)


def _stream() -> io.TextIOWrapper:
    own = sys.__stdout__
    if own is None:  # devnull takes the descriptor of standard output, so that no other file or child process gets it
        raw = StandardOutput(os.open(os.devnull, os.O_WRONLY), "w")
        raw.closed_from_start = True
        return io.TextIOWrapper(io.BufferedWriter(raw))
    raw = StandardOutput(own.fileno(), "w", closefd=False)
    return io.TextIOWrapper(io.BufferedWriter(raw), own.encoding, own.errors, line_buffering=own.isatty())
