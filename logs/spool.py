"""A long MCAP recording unpacked into plain arrays on disk: any stretch of it can then be read, and none needs the others' memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from logs.align import held
from logs.damage import Damage
from logs.joint_topic import JointTopic
from logs.log import Log, State
from logs.mcap_log import FIELDS, check_count, check_schema, killed_now, recording_state
from logs.mcap_records import Batch, Channel
from logs.mcap_stream import McapStream
from logs.plausible import UNIT, bad_samples, first_fault
from logs.rosbag2 import bag_parts
from logs.schemas import DIAGNOSTICS, RECORDING, STATES, device_offset

LATTICE_SECONDS = 10.0


@dataclass
class Spool:
    """N samples on disk: stamps int64 ns and rows of q and tau, float64; readings of the current with stamps of their own.

    offset: ns from the device clock to the stamps. marks: the first sample of every LATTICE_SECONDS of the device clock that holds one.
    """

    path: Path
    folder: Path
    joint_names: tuple[str, ...]
    metadata: dict[str, str]
    findings: tuple[str, ...]
    state: State
    origin: int
    samples: int
    readings: int
    duration: float
    marks: list[int]
    offset: int = 0

    def log(self, lo: int, hi: int) -> Log:
        """Samples lo to hi; NaN for what is not kept."""
        n = len(self.joint_names)
        stamp = self._read("stamp", np.int64, lo, hi)
        values = self._read("state", np.float64, lo * 2 * n, hi * 2 * n).reshape(-1, 2 * n)
        nothing = np.broadcast_to(np.float64(np.nan), (hi - lo, n))
        t = (stamp - self.origin) * 1e-9
        return Log(
            self.joint_names, t=t, t_host=np.full(len(t), np.nan), q=values[:, :n].copy(), dq=nothing, tau=values[:, n:].copy(),
            current=self._current(stamp), temperature=nothing, q_cmd=nothing, dq_cmd=nothing, tau_cmd=nothing,
            metadata=self.metadata, findings=self.findings if lo == 0 else (), path=self.path, state=self.state, t_origin=self.origin - self.offset,
        )  # fmt: skip

    def _current(self, stamp: np.ndarray) -> np.ndarray:
        """Readings from the last before the first sample to the first after the last, put on the samples."""
        n = len(self.joint_names)
        own = np.memmap(self.folder / "reading_stamp", np.int64, "r") if self.readings else np.empty(0, dtype=np.int64)
        lo = max(int(np.searchsorted(own, stamp[0], "right")) - 1, 0)
        hi = min(int(np.searchsorted(own, stamp[-1])) + 1, len(own))
        if hi <= lo:
            return np.broadcast_to(np.float64(np.nan), (len(stamp), n))
        damage = Damage(self.path)
        topic = JointTopic(DIAGNOSTICS, 2, self.joint_names, damage)
        current = self._read("current", np.float64, lo * n, hi * n).reshape(-1, n)
        topic.stamp, topic.host = [np.array(own[lo:hi])], [np.array(own[lo:hi])]
        topic.values = [[current, np.broadcast_to(np.float64(np.nan), current.shape)]]
        return held(topic, stamp, (stamp - stamp[0]) * 1e-9, n, 2, damage, between=(0,))[0]

    def _read(self, name: str, kind: type, lo: int, hi: int) -> np.ndarray:
        size = np.dtype(kind).itemsize
        return np.fromfile(self.folder / name, dtype=kind, count=hi - lo, offset=lo * size)


def spool(path: Path, joint_names: tuple[str, ...], folder: Path, accept_partial: bool = False) -> Spool:
    """Unpack the joint states and currents of an MCAP file, or of the parts of a rosbag2 folder, into `folder`.

    BadLog as `logs.read_log` raises it, at the first damage; memory does not grow with the recording.
    """
    damage = Damage(path, accept_partial)
    folder.mkdir(parents=True, exist_ok=True)
    metadata: dict[str, dict[str, str]] = {}
    ended, unsealed, killed = True, 0, None
    with _Files(folder, joint_names, damage) as out:
        for part in bag_parts(path, damage) if path.is_dir() else [path]:
            dead = killed_now(part)
            with part.open("rb") as file:
                stream = McapStream(file, part.stat().st_size, damage)
                for batch in stream.batches():
                    out.take(batch, stream.channels)
            metadata |= stream.metadata
            ended &= stream.ended
            unsealed += stream.unsealed
            if stream.journal:
                killed = dead
    recording = metadata.get(RECORDING, {})
    others = sum(topic.others for name, topic in out.topics.items() if name.endswith(STATES))
    check_count(recording, out.samples + out.left_out + others, damage)
    state = recording_state(metadata, ended, killed, damage)
    if unsealed:
        damage.note(f"the last {unsealed} bytes are an incomplete sample and are left out")
    if not out.samples:
        raise damage.refuse(
            "topics",
            f"no message on {STATES} with the joints {', '.join(joint_names)}",
            "record joint states, or name the joints as the log does",
        )
    words = {key: value for name, record in metadata.items() if name == RECORDING for key, value in record.items()}
    words |= {f"{name}.{key}": value for name, record in metadata.items() if name != RECORDING for key, value in record.items()}
    return Spool(
        path, folder, joint_names, words, damage.all_findings(), state, out.origin, out.samples, out.readings,
        (out.last - out.origin) * 1e-9, out.marks, device_offset(metadata) or 0,
    )  # fmt: skip


@dataclass
class _Files:
    """Takes batches of messages apart and appends what is kept to the files."""

    folder: Path
    joint_names: tuple[str, ...]
    damage: Damage
    topics: dict[str, JointTopic] = field(default_factory=dict)
    origin: int = 0
    last: int = 0
    samples: int = 0
    readings: int = 0
    left_out: int = 0
    marks: list[int] = field(default_factory=list)
    _files: dict[str, BinaryIO] = field(default_factory=dict)
    _tail: tuple[np.ndarray, np.ndarray] | None = None

    def __enter__(self) -> _Files:
        for name in ("stamp", "state", "reading_stamp", "current"):
            self._files[name] = (self.folder / name).open("wb")
        return self

    def __exit__(self, *about: object) -> None:
        for file in self._files.values():
            file.close()

    def take(self, batch: Batch, channels: dict[int, Channel]) -> None:
        heads = batch.heads
        for number in batch.counts:
            channel = channels.get(number)
            if channel is None or not channel.topic.endswith((STATES, DIAGNOSTICS)):
                continue
            kind = channel.schema.replace("sensor_msgs/JointState", "sensor_msgs/msg/JointState")
            if kind not in FIELDS:
                continue
            topic = self._topic(channel, kind)
            mine = heads["channel"] == number
            topic.take(batch, batch.starts[mine], heads[mine])
            self._drain(topic)

    def _topic(self, channel: Channel, kind: str) -> JointTopic:
        if channel.topic not in self.topics:
            check_schema(channel, kind, self.damage)
            end = STATES if channel.topic.endswith(STATES) else DIAGNOSTICS
            rivals = [t for t in self.topics if t.endswith(end)]
            if rivals:
                names = ", ".join(sorted([*rivals, channel.topic]))
                raise self.damage.refuse("topics", f"several end in {end}: {names}", "keep one arm in a recording")
            self.topics[channel.topic] = JointTopic(channel.topic, FIELDS[kind], self.joint_names, self.damage)
        return self.topics[channel.topic]

    def _drain(self, topic: JointTopic) -> None:
        if not topic.stamp:
            return
        stamp = np.concatenate(topic.stamp)
        first, *others = (topic.joined(k) for k in range(topic.fields))
        topic.clear()
        if topic.topic.endswith(DIAGNOSTICS):
            self._put("reading_stamp", stamp)
            self._put("current", first)
            self.readings += len(stamp)
        else:
            self._states(stamp, first, others[1])

    def _states(self, stamp: np.ndarray, q: np.ndarray, tau: np.ndarray) -> None:
        if not self.samples:
            self.origin = int(stamp[0])
        lead = self._tail
        if lead is not None:
            stamp, q = np.concatenate([lead[0], stamp]), np.concatenate([lead[1], q])
            tau = np.concatenate([np.full((1, tau.shape[1]), np.nan), tau])
        t = (stamp - self.origin) * 1e-9
        back = np.flatnonzero(np.diff(t) < 0)
        if len(back):
            k = int(back[0])
            raise self.damage.refuse(
                f"sample {self.samples + k}", f"device time runs back from {t[k]:.6f} s to {t[k + 1]:.6f} s",
                "a counter that wrapped around is put right by `calib import`; else record it again, or cut the file there",
            )  # fmt: skip
        keep = np.ones(len(t), dtype=bool)
        values = {"q": q, "tau": tau}
        fault = first_fault(t, values)
        if fault is not None:
            self.damage.report(
                f"sample {self.samples + fault.sample} at {t[fault.sample]:.4f} s, {fault.channel} of {self.joint_names[fault.joint]}",
                f"{fault.value:.6g} {UNIT[fault.channel]} is not a reading of an arm (rule: {fault.rule})",
            )
            keep = ~bad_samples(t, values)
            self.left_out += int((~keep).sum())
        if lead is not None:
            keep[0] = False
        stamp, q, tau = stamp[keep], q[keep], tau[keep]
        if not len(stamp):
            return
        self._mark(stamp)
        self._put("stamp", stamp)
        self._put("state", np.concatenate([q, tau], axis=1))
        self.samples += len(stamp)
        self.last = int(stamp[-1])
        self._tail = stamp[-1:].copy(), q[-1:].copy()

    def _mark(self, stamp: np.ndarray) -> None:
        cell = (stamp - self.origin) // int(LATTICE_SECONDS * 1e9)
        before = (self.last - self.origin) // int(LATTICE_SECONDS * 1e9) if self.samples else -1
        new = np.flatnonzero(np.diff(cell, prepend=before) > 0)
        self.marks += [self.samples + int(k) for k in new]

    def _put(self, name: str, values: np.ndarray) -> None:
        self._files[name].write(np.ascontiguousarray(values).data)
