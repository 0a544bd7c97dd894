"""The recordings that a command was given: read for one arm, and what is missing in them said aloud."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

from calib import console
from logs import Log, Pieces, open_pieces, read_log
from sim.arm import Arm
from sim.errors import ConfigError, EmptyLog
from sim.resources import nearest

T = TypeVar("T", Log, Pieces)

SUFFIXES = (".mcap", ".csv")


def read_logs(paths: Iterable[Path], arm: Arm, accept_partial: bool = False) -> list[Log]:
    """The logs, columns in the arm's order; every finding (gaps, losses, clocks) goes to standard error.

    BadLog for a recording that was cut short or is damaged, unless `accept_partial`.
    """
    return _each(paths, arm, lambda k, path: read_log(path, arm.joint_names, accept_partial=accept_partial))


def read_pieces(paths: Iterable[Path], arm: Arm, scratch: Path, accept_partial: bool = False) -> Pieces:
    """The logs in pieces that are read when they are needed, large files unpacked below `scratch`; otherwise as `read_logs`."""
    return Pieces.joined(
        _each(paths, arm, lambda k, path: open_pieces(path, arm.joint_names, scratch / str(k), accept_partial))
    )


def _each(paths: Iterable[Path], arm: Arm, read: Callable[[int, Path], T]) -> list[T]:
    """What `read` makes of each; one without a sample is left out and told, and is an error where no other is left."""
    found: list[T] = []
    empty = None
    for k, path in enumerate(paths):
        require(path)
        try:
            part = read(k, path)
        except EmptyLog as error:
            empty = error
            console.warn(f"{error}; it is left out")
            continue
        _say(path, part, arm)
        found.append(part)
    if empty is not None and not found:
        raise empty
    return found


def require_unseen(logs: Iterable[Path], held_out: Iterable[Path]) -> None:
    """ConfigError where a recording is given on both sides: a log that the fit has seen says nothing of logs that it has not."""
    seen = {path.resolve() for path in logs}
    for path in held_out:
        if path.resolve() in seen:
            raise ConfigError(
                f"--holdout {path}: is also one of the logs to fit; hold out a recording of another motion, or leave --holdout away"
            )


def require(path: Path) -> None:
    """ConfigError with the nearest name where there is no such file."""
    if path.exists():
        return
    folder = path.parent
    if not folder.is_dir():
        raise ConfigError(f"{path}: there is no folder {folder}; give the path of a recording: .mcap, .csv or a rosbag2 folder")
    there = sorted(str(p) for p in folder.iterdir() if p.suffix in SUFFIXES)
    raise ConfigError(f"there is no recording {str(path)!r}; {nearest(str(path), there)}")


def _say(path: Path, log: Log | Pieces, arm: Arm) -> None:
    recorded = log.metadata.get("arm")
    if recorded and recorded != arm.name:
        console.warn(
            f"{path}: was recorded of {recorded} and is read for {arm.name}; if these are two arms, name the right one: the numbers mean nothing"
        )
    for finding in log.findings:
        console.warn(f"{path}: {finding}")
