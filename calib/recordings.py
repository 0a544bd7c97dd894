"""The recordings that a command was given: read for one arm, and what is missing in them said aloud."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from calib import console
from logs import Log, Pieces, open_pieces, read_log
from sim.arm import Arm


def read_logs(paths: Iterable[Path], arm: Arm, accept_partial: bool = False) -> list[Log]:
    """The logs, columns in the arm's order; every finding (gaps, losses, clocks) goes to standard error.

    BadLog for a recording that was cut short or is damaged, unless `accept_partial`.
    """
    logs = []
    for path in paths:
        log = read_log(path, arm.joint_names, accept_partial=accept_partial)
        for finding in log.findings:
            console.warn(f"{path}: {finding}")
        logs.append(log)
    return logs


def read_pieces(paths: Iterable[Path], arm: Arm, scratch: Path, accept_partial: bool = False) -> Pieces:
    """The logs in pieces that are read when they are needed, large files unpacked below `scratch`; otherwise as `read_logs`."""
    parts = []
    for k, path in enumerate(paths):
        pieces = open_pieces(path, arm.joint_names, scratch / str(k), accept_partial)
        for finding in pieces.findings:
            console.warn(f"{path}: {finding}")
        parts.append(pieces)
    return Pieces.joined(parts)
