"""The recordings given to a command, read for one arm, with warnings about what is missing in them."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from calib.gate.commands import read_as
from calib.past_runs import LATEST
from calib.terminal import console
from logs import Log, Pieces, is_log, open_pieces, read_log
from logs.about import ARM_FOLDER, attachments, is_inside
from logs.read import SUFFIXES
from sim.arm import Arm, folder_of, load_arm
from sim.errors import BadLog, ConfigError, EmptyLog
from sim.files import is_name
from sim.resources import did_you_mean

T = TypeVar("T", Log, Pieces)

GIVE = "give the path of a recording: an .mcap or .csv file or a rosbag2 folder"
MOST_NAMES = 8  # of the recordings that a message lists


def arm_and_logs(first: str, logs: Sequence[Path] | None, configs: Path | None) -> tuple[Arm, list[Path]]:
    """The arm that `first` names, and the recordings; if `first` is itself a recording, it comes first and provides the arm.

    An arm takes precedence over a recording folder of the same name; `./NAME` is the folder.
    """
    logs = list(logs or [])
    if is_log(first) and folder_of(first, configs) is None:
        require(Path(first))
        return recorded_arm(Path(first), configs), [Path(first), *logs]
    arm = load_arm(first, configs)
    if not logs:
        raise ConfigError(f"no recording of {arm.name} was given; name one: .mcap, .csv or a rosbag2 folder")
    return arm, logs


def recorded_arm(path: Path, configs: Path | None = None) -> Arm:
    """The arm stored in the recording, else the arm of `configs` that it names, with a warning if that has changed since.

    BadLog if the stored arm is not the recorded one; ConfigError if the recording neither holds nor names an arm.
    """
    attached, metadata = attachments(path)
    name, sha256 = metadata.get("arm", ""), metadata.get("arm_sha256")
    if "arm/arm.toml" in attached:
        folder = Path(tempfile.mkdtemp(prefix="calib-arm-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        for inside, data in attached.items():
            if is_inside(inside):
                file = folder / inside
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(data)
        arm = load_arm(folder / ARM_FOLDER)
        if arm.sha256 != sha256:
            raise BadLog(f"{path}: the arm in it is not the one that was recorded; name the arm: `calib ... ARM {path}`")
        return arm
    if not is_name(name):
        raise ConfigError(f"{path}: neither holds an arm nor names one; name it: `calib ... ARM {path}`")
    arm = load_arm(name, configs)
    if sha256 and arm.sha256 != sha256:
        console.warn(f"{path}: {arm.name} has changed since this was recorded; to be sure, name the arm folder of that time")
    return arm


def read_logs(
    paths: Iterable[Path], arm: Arm, accept_partial: bool = False, assume: Sequence[str] | None = None
) -> list[Log]:  # fmt: skip
    """The logs, columns in the arm's order; every finding (gaps, losses, clocks) goes to standard error.

    BadLog for a recording that was cut short or is damaged, unless `accept_partial`. assume: words of `calib.gate.correction`.
    """
    return _each(
        paths, arm, lambda k, path: read_as(read_log(path, arm.joint_names, accept_partial=accept_partial), assume or ())
    )


def read_pieces(
    paths: Iterable[Path], arm: Arm, scratch: Path, accept_partial: bool = False, assume: Sequence[str] | None = None
) -> Pieces:  # fmt: skip
    """The logs in pieces that are read when they are needed, large files unpacked below `scratch`; otherwise as `read_logs`."""
    change = partial(read_as, assume=assume) if assume else None
    return Pieces.joined(
        _each(paths, arm, lambda k, path: open_pieces(path, arm.joint_names, scratch / str(k), accept_partial, change))
    )


def _each(paths: Iterable[Path], arm: Arm, read: Callable[[int, Path], T]) -> list[T]:
    """`read` of each path; a recording without samples is left out with a warning, or is an error if no other remains."""
    found: list[T] = []
    empty: list[EmptyLog] = []
    for k, path in enumerate(paths):
        require(path)
        try:
            part = read(k, path)
        except EmptyLog as error:
            empty.append(error)
            continue
        _warn(path, part, arm)
        found.append(part)
    if empty and not found:
        raise empty[0]
    for one in empty:
        console.warn(f"{one}; it is left out")
    return found


def require_unseen(logs: Iterable[Path], held_out: Iterable[Path]) -> None:
    """ConfigError if a recording is both fitted and held out: a log that the fit has seen is no test of the fit."""
    seen = {os.path.realpath(path) for path in logs}  # unlike Path.resolve, it accepts a link to itself
    for path in held_out:
        if os.path.realpath(path) in seen:
            raise ConfigError(
                f"--holdout {path}: is also one of the logs to fit; hold out a recording of another motion, or leave out --holdout"
            )


def require(path: Path) -> None:
    """ConfigError if there is no such file, with what may be given and the recordings in its folder."""
    if os.path.exists(path):
        return
    folder = path.parent
    if not folder.is_dir():
        raise ConfigError(f"{path}: there is no folder {folder}; {GIVE}")
    if os.path.islink(path):
        raise ConfigError(f"{path}: is a link to {path.readlink()}, which does not exist; {GIVE}")
    there = sorted(str(p) for p in folder.iterdir() if p.suffix.lower() in {*SUFFIXES, path.suffix} - {""} and p.exists())
    near = did_you_mean(str(path), there)
    listed = ", ".join(there[:MOST_NAMES]) + (", ..." if len(there) > MOST_NAMES else "")
    beside = f"; there are {listed}" if there and not near else ""
    why = f" (`{LATEST}` names a run or an arm)" if str(path) == LATEST else ""
    raise ConfigError(f"there is no recording {str(path)!r}{why}; {near}{GIVE}{beside}")


def _warn(path: Path, log: Log | Pieces, arm: Arm) -> None:
    recorded = log.metadata.get("arm")
    if recorded and recorded != arm.name:
        console.warn(
            f"{path}: was recorded with {recorded} and is read for {arm.name}; if these are two arms, name the right one"
        )
    for finding in log.findings:
        console.warn(f"{path}: {finding}")
    for sentence in _sampling(log):
        console.warn(f"{path}: {sentence}")


def _sampling(log: Log | Pieces) -> tuple[str, ...]:
    """Faults of the sampling (of the first piece): jittered stamps and repeated samples, which an import corrects, and lost samples that are not gaps.

    Empty for a log with two clocks, or with stamps that go back.
    """
    from logs.convert import sampling_of

    first = log[0] if isinstance(log, Pieces) and len(log) else log
    if isinstance(first, Pieces) or not len(first) or np.isfinite(first.t_host).any() or np.any(np.diff(first.t) < 0):
        return ()
    found = sampling_of(first)
    if not (found.rebuilt or found.repeated):
        return ("; ".join(found.losses),) if found.losses else ()
    return (*found.findings, "they are used as they are; `calib import` corrects what can be corrected")
