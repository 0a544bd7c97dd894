"""Which recordings there are, and which arm each is of: read from the recording's metadata, not from its name.

An arm is identified by its model, the cell it stands in and its serial number: an arm that was replaced, or moved, is another one.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, SeekingReader

from logs.mcap_records import MAGIC, MAX_RECORD
from logs.prediction import PREDICTED
from logs.read import SUFFIXES
from logs.schemas import RECORDING
from sim.errors import BadLog, ConfigError
from sim.files import is_name, open_regular, printable

SUFFIX = ".mcap"
IMPORT = "import it with `calib import FILE --arm ARM`, which records the arm, and put the new file in its place"
REMOVE = "put a recording in its place, or remove it"
MAX_WORD = 500  # characters of an entry of a recording's metadata; six serial numbers take a hundred
MAX_FOLDER = 120
LATEST = 4_102_444_800 * 10**9  # ns, 2100: a later time is refused


@dataclass(frozen=True)
class Recorded:
    """One recording: address, size in bytes, a mark that changes with its content, and its metadata.

    arm is the model's name in configs/arms, with the hash of the folder that it was recorded with; motion is its name in the plan;
    started is in ISO form, UTC, "" where it is not stated.
    """

    address: str
    size: int
    mark: str
    arm: str
    arm_sha256: str
    cell: str
    serial: str
    motion: str
    started: str

    @property
    def identity(self) -> tuple[str, str, tuple[str, ...]]:
        """Which arm this is: its model's name, its cell, and the serial numbers of its parts."""
        return self.arm, self.cell, tuple(part.strip() for part in self.serial.split(","))

    @property
    def arm_id(self) -> str:
        """The arm's name in the fleet, and that of its folder: different for every identity.

        Model, cell and serial numbers, joined by plus signs. Characters other than letters, digits, dots, dashes and underscores are
        replaced, and too long a name is cut; a hash of the identity then follows after "~".
        """
        arm, cell, parts = self.identity
        words = [arm, cell, ",".join(parts)]
        plain = [re.sub(r"[^A-Za-z0-9._,-]", "_", word, flags=re.ASCII) for word in words]
        name = "+".join(plain).rstrip("+")
        if plain == words and "," not in arm + cell and len(name) <= MAX_FOLDER:
            return name
        digest = hashlib.sha256(json.dumps(self.identity).encode()).hexdigest()[:16]
        return f"{name[:MAX_FOLDER]}~{digest}"


def inventory(address: str) -> tuple[list[Recorded], list[tuple[str, str]]]:
    """The recordings below a folder (a path, or any address that fsspec reads), and those whose arm is unknown, with the reason.

    prediction.mcap, which `calib validate` writes, is no recording.

    ConfigError where there is no such folder or it holds no recording.
    """
    system, found = _files(address)
    recordings, unknown = [], []
    for path, about in sorted(found.items()):
        if not path.endswith(SUFFIX):
            continue
        full = _full(system, path)
        try:
            if (recording := _recorded(system, path, full, about)) is not None:
                recordings.append(recording)
        except (BadLog, OSError) as error:
            unknown.append((printable(full), printable(error)))
        except Exception as error:  # one recording, whatever is in it, must not stop the others
            unknown.append((printable(full), printable(f"{full}: cannot be read ({type(error).__name__}: {str(error)[:200]})")))
    if not recordings and not unknown:
        raise ConfigError(f"{address}: holds no recording ({SUFFIX}); give the folder that the recordings are below")
    return recordings, unknown


def foreign(address: str) -> list[str]:
    """The recordings below a folder that are in another format, which a fleet does not read."""
    system, found = _files(address)
    others = [suffix for suffix in SUFFIXES if suffix != SUFFIX]
    return [printable(_full(system, path)) for path in sorted(found) if Path(path).suffix.lower() in others]


def by_arm(recordings: Iterable[Recorded]) -> dict[str, tuple[Recorded, ...]]:
    """The recordings of every arm, oldest first; arms in the order of their names."""
    arms: dict[tuple[str, str, tuple[str, ...]], list[Recorded]] = {}
    for recording in recordings:
        arms.setdefault(recording.identity, []).append(recording)
    named = {own[0].arm_id: own for own in arms.values()}
    return {arm_id: tuple(sorted(named[arm_id], key=lambda r: (r.started, r.address))) for arm_id in sorted(named)}


def is_local(system: Any) -> bool:
    """Whether a file system of fsspec is this computer's."""
    return "file" in np.atleast_1d(system.protocol)


def _files(address: str) -> tuple[Any, dict[str, dict[str, Any]]]:
    """The file system of an address, and the files below it."""
    try:
        system, root = fsspec.core.url_to_fs(address)
        if not system.isdir(root):
            raise ConfigError(f"{address}: is not a folder; give the folder that the recordings are below")
        return system, system.find(root, detail=True)
    except (OSError, ValueError, ImportError) as error:
        raise ConfigError(
            f"{address}: cannot be listed ({error}); give a path or an address whose fsspec package is installed"
        ) from error


def _full(system: Any, path: str) -> str:
    """The address of a file: its path on this computer, elsewhere with its protocol."""
    return path if is_local(system) else str(system.unstrip_protocol(path))


def _recorded(system: Any, path: str, address: str, about: dict[str, Any]) -> Recorded | None:
    """None for a file for viewers that `calib validate` derived from a recording."""
    # a pipe or a device, which `open` would wait for, is refused
    with open_regular(Path(path), BadLog, REMOVE) if is_local(system) else system.open(path, "rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise BadLog(f"{address}: is not an MCAP file; {IMPORT}, or remove it")
        words = _words(file, address)
        if not words and _is_derived(file):
            return None
    if not words.get("arm"):
        raise BadLog(f"{address}: does not state its arm; {IMPORT}")
    for key in ("arm", "arm_sha256", "cell", "serial", "motion"):
        if len(words.get(key, "")) > MAX_WORD or printable(words.get(key, "")) != words.get(key, ""):
            raise BadLog(f"{address}: its {key} is longer than {MAX_WORD} characters or cannot be printed; record it again")
    if not is_name(words["arm"]):
        raise BadLog(
            f"{address}: states the arm {words['arm']!r}; the name of an arm has 1 to 64 letters, digits, dots, dashes and underscores, "
            "and is never a path"
        )
    started = _started(words.get("wall_clock_start_ns", ""), address)
    mark = next((str(about[key]) for key in ("ETag", "etag", "md5Hash", "mtime", "LastModified") if about.get(key)), "")
    return Recorded(
        address, int(about["size"]), mark, words["arm"], words.get("arm_sha256", ""), words.get("cell", ""), words.get("serial", ""),
        words.get("motion", ""), started,
    )  # fmt: skip


def _started(ns: str, address: str) -> str:
    """The ISO form of an instant in nanoseconds since 1970; "" where there is none."""
    if not ns:
        return ""
    if not re.fullmatch(r"[0-9]{1,19}", ns, re.ASCII) or int(ns) > LATEST:
        raise BadLog(f"{address}: wall_clock_start_ns = {ns[:24]!r} is not a time in nanoseconds since 1970, before 2100")
    return datetime.fromtimestamp(int(ns) // 10**9, UTC).isoformat(timespec="seconds")


def _is_derived(file: Any) -> bool:
    """Whether a file holds predictions beside the measured torques."""
    file.seek(0)
    try:
        summary = SeekingReader(file, record_size_limit=MAX_RECORD).get_summary()
    except (McapError, ValueError, EOFError, StopIteration, RuntimeError):
        return False
    return summary is not None and any(channel.topic == PREDICTED for channel in summary.channels.values())


def _words(file: Any, address: str) -> dict[str, str]:
    """The metadata record `recording`: the end of a finished file states where it is; a file that was never finished begins with it."""
    fault: Exception | None = None
    for kind in (SeekingReader, NonSeekingReader):
        try:
            file.seek(0)
            for record in kind(file, record_size_limit=MAX_RECORD).iter_metadata():
                if record.name == RECORDING:
                    return dict(record.metadata)
            return {}
        except (McapError, ValueError, EOFError, StopIteration, RuntimeError) as error:
            fault = error
    raise BadLog(f"{address}: its metadata cannot be read ({type(fault).__name__}: {fault}), so its arm is unknown; {IMPORT}")
