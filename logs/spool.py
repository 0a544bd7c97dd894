"""A long MCAP recording unpacked into plain arrays on disk: any stretch can then be read without the memory of the rest.

The rules of a short recording apply (logs.assembly), over arrays on disk: what is refused, left out or reordered is the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from logs.align import INTERPOLATED, at_samples, beside, reading_times
from logs.assembly import chosen, in_order, left_out, states_of, unstamped, words_of
from logs.damage import Damage
from logs.joint_topic import JointTopic
from logs.log import CHANNELS, COMMANDED, MEASURED, Log, State
from logs.mcap_log import scanned
from logs.rosbag2 import bag_parts
from logs.schemas import COMMANDS, DIAGNOSTICS, STATES, device_offset
from logs.timing import checked_times
from sim.errors import DeviceError

ROWS = 1 << 16  # in memory at once
COUNTS = ("stamp", "host", "sequence")


@dataclass
class Spool:
    """N samples on disk: times (N,) s from `origin` (ns, device clock), and rows of each recorded channel in CHANNELS, float64."""

    path: Path
    folder: Path
    joint_names: tuple[str, ...]
    metadata: dict[str, str]
    findings: tuple[str, ...]
    state: State
    origin: int
    samples: int

    @property
    def t(self) -> np.ndarray:
        """(N,) s; on disk."""
        return np.memmap(self.folder / "t", np.float64, "r")

    def log(self, lo: int, hi: int) -> Log:
        """Samples lo to hi - 1; NaN for what was not recorded, and for the host clock."""
        q, dq, tau, current, temperature, q_cmd, dq_cmd, tau_cmd = (self._read(name, lo, hi) for name in CHANNELS)
        return Log(
            self.joint_names, t=np.array(self.t[lo:hi]), t_host=np.full(hi - lo, np.nan), q=q, dq=dq, tau=tau, current=current,
            temperature=temperature, q_cmd=q_cmd, dq_cmd=dq_cmd, tau_cmd=tau_cmd, metadata=self.metadata,
            findings=self.findings if lo == 0 else (), path=self.path, state=self.state, t_origin=self.origin,
        )  # fmt: skip

    def _read(self, name: str, lo: int, hi: int) -> np.ndarray:
        n = len(self.joint_names)
        if not (self.folder / name).exists():
            return np.broadcast_to(np.float64(np.nan), (hi - lo, n))
        return np.fromfile(self.folder / name, np.float64, (hi - lo) * n, offset=8 * lo * n).reshape(-1, n)


def spool(path: Path, joint_names: tuple[str, ...], folder: Path, accept_partial: bool = False) -> Spool:
    """Unpack all readings and commands of an MCAP file, or of the parts of a rosbag2 folder, into `folder`.

    Samples and BadLog are those of `logs.read_log`; DeviceError where `folder` cannot be written. Memory grows by some tens of
    bytes per sample: times and orders are held as a whole, values never.
    """
    with _writing(folder):
        return _spooled(path, joint_names, folder, Damage(path, accept_partial))


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Raise what the disk of the folder refuses as DeviceError: the recording is not at fault."""
    try:
        yield
    except OSError as error:
        raise DeviceError(
            f"{folder}: cannot be written ({error.strerror}); free space there, as much as the recording takes unpacked, or use another disk"
        ) from error


def _spooled(path: Path, joint_names: tuple[str, ...], folder: Path, damage: Damage) -> Spool:
    folder.mkdir(parents=True, exist_ok=True)
    n = len(joint_names)
    stored: dict[str, _Stored] = {}
    with ExitStack() as files:

        @_writing(folder)
        def keep(topics: dict[str, JointTopic]) -> None:
            for topic in topics.values():
                if topic.stamp and topic.topic.endswith((STATES, COMMANDS, DIAGNOSTICS)):
                    if topic.topic not in stored:
                        stored[topic.topic] = _Stored(folder / f"topic{len(stored)}", topic.fields, n, files)
                    stored[topic.topic].add(topic)
                topic.clear()

        scan = scanned(bag_parts(path, damage) if path.is_dir() else [path], joint_names, damage, keep)
    states, names = states_of(scan.topics, joint_names, damage)
    own = stored[states.topic]
    clock = "host" if unstamped(own.counts("stamp"), states, damage) else "stamp"
    stamp = np.array(own.counts(clock))
    order = in_order(stamp, own.counts("host"), own.counts("sequence"), states, damage)
    stamp = stamp if order is None else stamp[order]
    values = [_rearranged(own.folder / f"ordered{k}", own.field(k), order) for k in range(3)]
    q_and_dq = values[0], values[1]
    t, _ = checked_times((stamp - stamp[0]) * 1e-9, np.broadcast_to(np.nan, len(stamp)), damage, q_and_dq)
    beside_samples: list[np.ndarray] = []
    for name, fields, between in ((COMMANDS, 3, ()), (DIAGNOSTICS, 2, (0,))):
        topic = chosen(scan.topics, name, damage)
        on_disk = stored.get(topic.topic) if topic else None
        if topic is None or on_disk is None:
            beside_samples += [np.broadcast_to(np.float64(np.nan), (len(t), n))] * fields
        else:
            beside_samples += _on_samples(on_disk, topic, clock, stamp, t, damage, between)
    arrays = dict(zip((*COMMANDED, "current", "temperature"), beside_samples, strict=True))
    arrays |= dict(zip(("q", "dq", "tau"), values, strict=True))
    bad = left_out(t, names, {name: arrays[name] for name in MEASURED}, damage)
    rows = None if bad is None else np.flatnonzero(~bad)
    t = t if rows is None else t[rows]
    t.tofile(folder / "t")
    for name in CHANNELS:
        _write(folder / name, arrays[name], rows)
    for one in stored.values():
        one.remove()
    return Spool(
        path, folder, names, words_of(scan.metadata), damage.all_findings(), scan.state,
        int(stamp[0]) - (device_offset(scan.metadata) or 0), len(t),
    )  # fmt: skip


class _Stored:
    """Messages of one topic on disk, in the order they came.

    Stamps, host times and sequence numbers are int64, fields are rows of n float64.
    """

    def __init__(self, folder: Path, fields: int, n: int, files: ExitStack) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, self.fields, self.n, self.count = folder, fields, n, 0
        names = (*COUNTS, *map(str, range(fields)))
        self._files: dict[str, BinaryIO] = {name: files.enter_context((folder / name).open("wb")) for name in names}
        self._given = [False] * fields

    def add(self, topic: JointTopic) -> None:
        """Move to disk what the topic holds."""
        count = sum(map(len, topic.stamp))
        for name in COUNTS:
            self._files[name].write(np.concatenate(getattr(topic, name)).data)
        for k in range(self.fields):
            part = topic.joined(k)
            if not (self._given[k] or part.strides[0]):
                continue
            if not self._given[k]:
                self._given[k] = True
                for at in range(0, self.count, ROWS):
                    self._files[str(k)].write(np.full((min(ROWS, self.count - at), self.n), np.nan).data)
            self._files[str(k)].write(np.ascontiguousarray(part).data)
        self.count += count

    def counts(self, name: str) -> np.ndarray:
        """(M,) int64: one of COUNTS."""
        return np.memmap(self.folder / name, np.int64, "r")

    def field(self, k: int) -> np.ndarray:
        """(M, n); NaN where no message has it."""
        if not self._given[k]:
            return np.broadcast_to(np.float64(np.nan), (self.count, self.n))
        return np.memmap(self.folder / str(k), np.float64, "r", shape=(self.count, self.n))

    def remove(self) -> None:
        """Delete the files."""
        for file in self.folder.iterdir():
            file.unlink()
        self.folder.rmdir()


def _on_samples(
    stored: _Stored, topic: JointTopic, clock: str, stamp: np.ndarray, t: np.ndarray, damage: Damage, between: tuple[int, ...]
) -> list[np.ndarray]:
    """Fields of a topic, with `clock` as its times, on the samples, (N, n) on disk, as `logs.align.held` puts them there."""
    own, parts = np.array(stored.counts(clock)), [stored.field(k) for k in range(stored.fields)]
    if len(own) == len(stamp) and np.array_equal(own, stamp):
        return parts
    at, order = reading_times(own, int(stamp[0]), topic.topic, damage)
    out = []
    for k, part in enumerate(parts):
        if not part.strides[0]:
            out.append(np.broadcast_to(np.float64(np.nan), (len(t), stored.n)))
            continue
        if k in between and beside(at, t):
            damage.note(INTERPOLATED.format(topic.topic))
        file = stored.folder / f"held{k}"
        with file.open("wb") as out_file:
            for lo in range(0, len(t), ROWS):
                out_file.write(at_samples(at, part, order, t[lo : lo + ROWS], k in between).data)
        out.append(np.memmap(file, np.float64, "r", shape=(len(t), stored.n)))
    return out


def _rearranged(file: Path, values: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
    """These rows of the values, on disk; all where None is given."""
    if rows is None or not values.strides[0]:
        return values if rows is None else values[: len(rows)]
    _write(file, values, rows)
    return np.memmap(file, np.float64, "r", shape=(len(rows), values.shape[1]))


def _write(file: Path, values: np.ndarray, rows: np.ndarray | None) -> None:
    """Write these rows of the values to a file, all where None is given; no file where nothing was reported."""
    file.unlink(missing_ok=True)
    if not values.strides[0]:
        return
    with file.open("wb") as out:
        for lo in range(0, len(values) if rows is None else len(rows), ROWS):
            part = slice(lo, lo + ROWS) if rows is None else rows[lo : lo + ROWS]
            out.write(np.ascontiguousarray(values[part]).data)
