"""MCAP files with ROS 2 joint messages as a Log: our own recordings, and rosbag2 files with other topics in them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from logs.cdr import CdrError, Layout, joint_layout, log_message
from logs.damage import Damage
from logs.log import Event, Log, State
from logs.mcap_stream import MESSAGE, Batch, Channel, McapStream
from logs.plausible import UNIT, bad_samples, first_fault
from logs.schemas import COMMANDS, DIAGNOSTICS, EVENTS, RECORDING, SCHEMAS, STATES
from logs.timing import check_times

MAX_EVENTS = 100_000
MAX_LAYOUTS = 8  # layouts tried on a batch before its remaining messages are parsed one by one
FIELDS = {"sensor_msgs/msg/JointState": 3, "calib_msgs/msg/JointDiagnostics": 2}


@dataclass
class JointTopic:
    """Messages of one topic, decoded in pieces: stamps, host times and values in the order of `names`."""

    topic: str
    fields: int
    wanted: tuple[str, ...] | None
    damage: Damage
    stamp: list[np.ndarray] = field(default_factory=list)
    host: list[np.ndarray] = field(default_factory=list)
    values: list[list[np.ndarray]] = field(default_factory=list)
    others: int = 0
    layouts: dict[int, list[Layout]] = field(default_factory=dict)

    def take(self, batch: Batch, starts: np.ndarray, heads: np.ndarray) -> None:
        """Decode the messages at `starts`; those of one size and layout at once."""
        count = len(starts)
        stamp = np.zeros(count, dtype=np.int64)
        sound = np.zeros(count, dtype=bool)
        values: list[np.ndarray | None] = [None] * self.fields
        sizes = heads["length"].astype(np.int64) - (MESSAGE.itemsize - 9)
        for size in np.unique(sizes).tolist():
            left = np.flatnonzero(sizes == size)
            rows = batch.payloads(starts[left], size) if size else np.empty((len(left), 0), dtype=np.uint8)
            known = self.layouts.setdefault(size, [])
            tried = 0
            while len(left):
                layout = known[tried] if tried < len(known) else self._parsed(rows[0], batch, starts[left[0]])
                if layout is None:
                    left, rows = left[1:], rows[1:]
                    continue
                if tried >= len(known) and len(known) < MAX_LAYOUTS:
                    known.append(layout)
                # beyond MAX_LAYOUTS every message is parsed by itself: slow and correct, and never quadratic
                if tried < MAX_LAYOUTS:
                    match = layout.matches(rows)
                    places, matching, left, rows = left[match], rows[match], left[~match], rows[~match]
                else:
                    places, matching, left, rows = left[:1], rows[:1], left[1:], rows[1:]
                tried += 1
                if len(places):
                    stamp[places], sound[places] = layout.stamps(matching)
                    self._late(batch, starts[places[~sound[places]]])
                    self._place(layout, matching, places, values, sound, count, batch, starts)
        self._append(stamp, heads["log"].astype(np.int64), values, sound)

    def _parsed(self, row: np.ndarray, batch: Batch, start: int) -> Layout | None:
        try:
            return joint_layout(row.tobytes(), self.fields)
        except CdrError as error:
            self.damage.report(f"{batch.where}, message on {self.topic} at byte {start} in it", str(error))
            return None

    def _late(self, batch: Batch, starts: np.ndarray) -> None:
        if len(starts):
            self.damage.report(f"{batch.where}, message on {self.topic} at byte {starts[0]} in it", "a stamp with over 1e9 ns")

    def _place(
        self, layout: Layout, rows: np.ndarray, places: np.ndarray, values: list[np.ndarray | None], sound: np.ndarray,
        count: int, batch: Batch, starts: np.ndarray,
    ) -> None:  # fmt: skip
        """Values of matching messages into their columns, by joint name."""
        if self.wanted is None:
            self.wanted = layout.names
        missing = [name for name in self.wanted if name not in layout.names]
        if missing or not self.wanted:
            if len(missing) == len(self.wanted):
                self.others += len(places)
            else:
                self.damage.report(
                    f"{batch.where}, message on {self.topic} at byte {starts[places[0]]} in it",
                    f"joints {', '.join(missing)} are missing; it names {', '.join(layout.names)}",
                )
            sound[places] = False
            return
        columns = [layout.names.index(name) for name in self.wanted]
        for k in range(self.fields):
            part = layout.values(rows, k)
            if part is None:
                continue
            target = values[k]
            if target is None:
                target = values[k] = np.full((count, len(self.wanted)), np.nan)
            target[places] = part[:, columns]

    def _append(self, stamp: np.ndarray, host: np.ndarray, values: list[np.ndarray | None], sound: np.ndarray) -> None:
        if not sound.any():
            return
        n = len(self.wanted or ())
        self.stamp.append(stamp[sound])
        self.host.append(host[sound])
        nothing = np.broadcast_to(np.float64(np.nan), (int(sound.sum()), n))
        everything = bool(sound.all())
        self.values.append([nothing if part is None else part if everything else part[sound] for part in values])

    def joined(self, k: int) -> np.ndarray:
        """(M, n) values of field k; its pieces are given up, so that memory never holds all of them twice."""
        pieces = [parts[k] for parts in self.values]
        for parts in self.values:
            parts[k] = np.empty((0, 0))
        n = len(self.wanted or ())
        if not any(piece.strides[0] for piece in pieces):
            return np.broadcast_to(np.float64(np.nan), (sum(map(len, pieces)), n))
        out = np.empty((sum(map(len, pieces)), n))
        at = 0
        pieces.reverse()
        while pieces:
            piece = pieces.pop()
            out[at : at + len(piece)] = piece
            at += len(piece)
        return out


def read_mcap(paths: list[Path], joint_names: tuple[str, ...] | None, damage: Damage) -> Log:
    """One log of the joint messages in `paths` (the parts of a split recording, in order)."""
    topics: dict[str, JointTopic] = {}
    events: list[tuple[int, int, str, str]] = []
    metadata: dict[str, dict[str, str]] = {}
    ended, unsealed, journal = True, 0, False
    for path in paths:
        try:
            with path.open("rb") as file:
                stream = McapStream(file, path.stat().st_size, damage)
                for batch in stream.batches():
                    _take(batch, stream.channels, topics, events, joint_names, damage)
        except OSError as error:
            raise damage.refuse("file", f"cannot be read ({error.strerror})", "give a readable recording") from error
        metadata |= stream.metadata
        ended &= stream.ended
        unsealed += stream.unsealed
        journal |= stream.journal
    state = _state(metadata.get(RECORDING, {}), ended, journal, damage)
    if unsealed:
        damage.note(f"the last {unsealed} bytes are an incomplete sample and are left out")
    return _assembled(topics, events, metadata, state, joint_names, damage)


def _state(recording: dict[str, str], ended: bool, journal: bool, damage: Damage) -> State:
    """How the recording ended; anything but a clean end is refused unless a partial file is accepted."""
    if not journal:
        if not ended:
            damage.report("end of file", "the MCAP footer is missing: the file is cut")
            return State.CUT
        if damage.count:
            return State.CUT
        word = recording.get("state", "clean" if not recording else "")
    else:
        word = recording.get("state", "open")
        word = "open" if word == "clean" else word
    if word not in ("clean", "open", "aborted"):
        raise damage.refuse(
            "metadata record 'recording'", f"state {word!r}; clean, open and aborted are known", "record it again"
        )
    state = State[word.upper()]
    if state is not State.CLEAN:
        fault = f"{state.value} ({recording.get('end_reason') or 'no reason was written'})"
        if not damage.accept_partial:
            raise damage.refuse("state", fault, "record it again, or use what there is with --accept-partial")
        damage.note(fault)
    return state


def _take(
    batch: Batch, channels: dict[int, Channel], topics: dict[str, JointTopic], events: list[tuple[int, int, str, str]],
    joint_names: tuple[str, ...] | None, damage: Damage,
) -> None:  # fmt: skip
    heads = batch.heads()
    for number in np.unique(heads["channel"]).tolist():
        channel = channels.get(number)
        if channel is None:
            continue
        kind = channel.schema.replace("sensor_msgs/JointState", "sensor_msgs/msg/JointState")
        mine = heads["channel"] == number
        if kind in FIELDS:
            if channel.topic not in topics:
                _check_schema(channel, kind, damage)
                topics[channel.topic] = JointTopic(channel.topic, FIELDS[kind], joint_names, damage)
            topics[channel.topic].take(batch, batch.starts[mine], heads[mine])
        elif kind == "rcl_interfaces/msg/Log" and channel.topic == EVENTS:
            _take_events(batch, batch.starts[mine], heads[mine], events, damage)


def _take_events(
    batch: Batch, starts: np.ndarray, heads: np.ndarray, events: list[tuple[int, int, str, str]], damage: Damage
) -> None:
    if len(events) + len(starts) > MAX_EVENTS:
        raise damage.refuse(batch.where, f"more than {MAX_EVENTS} lines on {EVENTS}", "record it again")
    for start, length in zip(starts.tolist(), heads["length"].tolist(), strict=True):
        try:
            events.append(log_message(batch.data[start + MESSAGE.itemsize : start + 9 + length]))
        except CdrError as error:
            damage.report(f"{batch.where}, message on {EVENTS} at byte {start} in it", str(error))


def _check_schema(channel: Channel, kind: str, damage: Damage) -> None:
    """The fields must be those of the type that is read here: a name alone does not say how bytes are laid out."""
    if channel.encoding != "cdr" or channel.schema_encoding != "ros2msg":
        raise damage.refuse(
            f"topic {channel.topic}", f"encoding {channel.encoding!r} with schema {channel.schema_encoding!r}",
            "joint messages in CDR with a ros2msg schema are read here",
        )  # fmt: skip
    if _fields(channel.definition) != _fields(SCHEMAS[kind]):
        raise damage.refuse(
            f"topic {channel.topic}", f"its schema {channel.schema} has other fields than ROS 2's own",
            f"convert it to {'; '.join(_fields(SCHEMAS[kind]))}",
        )  # fmt: skip


def _fields(definition: str) -> list[str]:
    """Field lines of a ros2msg definition, comments and blank space removed."""
    top = re.split(r"^=+\s*$", definition, maxsplit=1, flags=re.MULTILINE)[0]
    lines = (" ".join(line.split("#", 1)[0].split()) for line in top.splitlines())
    return [line.replace("std_msgs/msg/Header", "std_msgs/Header").replace("builtin_interfaces/msg/", "builtin_interfaces/")
            for line in lines if line]  # fmt: skip


def _chosen(topics: dict[str, JointTopic], name: str, damage: Damage) -> JointTopic | None:
    """The topic `name`, or the only one that ends in it under a namespace."""
    if name in topics:
        return topics[name]
    under = [topic for topic in topics if topic.endswith(name)]
    if len(under) > 1:
        raise damage.refuse("topics", f"several end in {name}: {', '.join(sorted(under))}", "keep one arm in a recording")
    return topics[under[0]] if under else None


def _assembled(
    topics: dict[str, JointTopic], events: list[tuple[int, int, str, str]], metadata: dict[str, dict[str, str]], state: State,
    joint_names: tuple[str, ...] | None, damage: Damage,
) -> Log:  # fmt: skip
    states = _chosen(topics, STATES, damage)
    if states is None or not states.stamp or not states.wanted:
        wanted = f" with the joints {', '.join(joint_names)}" if joint_names else ""
        raise damage.refuse(
            "topics", f"no message on {STATES}{wanted}", "record joint states, or name the joints as the log does"
        )
    names = states.wanted
    if states.others:
        damage.note(f"{states.others} messages on {states.topic} are about other joints and were not read")
    stamp, host = np.concatenate(states.stamp), np.concatenate(states.host)
    t, t_host = (stamp - stamp[0]) * 1e-9, (host - host[0]) * 1e-9
    q, dq, tau = (states.joined(k) for k in range(3))
    q_cmd, dq_cmd, tau_cmd = _held(_named(topics, COMMANDS, names, damage), stamp, len(names), 3, damage)
    current, temperature = _held(_named(topics, DIAGNOSTICS, names, damage), stamp, len(names), 2, damage)
    check_times(t, damage)
    measured = {"q": q, "dq": dq, "tau": tau, "current": current, "temperature": temperature}
    arrays = {"t": t, "t_host": t_host, **measured, "q_cmd": q_cmd, "dq_cmd": dq_cmd, "tau_cmd": tau_cmd}
    fault = first_fault(t, measured)
    if fault is not None:
        damage.report(
            f"sample {fault.sample} at {t[fault.sample]:.4f} s, {fault.channel} of {names[fault.joint]}",
            f"{fault.value:.6g} {UNIT[fault.channel]} is not a reading of an arm (rule: {fault.rule})",
        )
        bad = bad_samples(t, measured)
        if bad.all():
            raise damage.refuse("samples", "no sound sample", "record it again")
        damage.note(f"{int(bad.sum())} of {len(t)} samples left out because a value in them is not a reading of an arm")
        arrays = {key: value[~bad] for key, value in arrays.items()}
    words = {key: value for name, record in metadata.items() if name == RECORDING for key, value in record.items()}
    words |= {f"{name}.{key}": value for name, record in metadata.items() if name != RECORDING for key, value in record.items()}
    lines = tuple(Event((at - int(stamp[0])) * 1e-9, level, name, text) for at, level, name, text in events)
    return Log(
        names, **arrays, metadata=words, events=lines, findings=damage.all_findings(), path=damage.path, state=state,
        t_origin=int(stamp[0]), t_host_origin=int(host[0]),
    )  # fmt: skip


def _named(topics: dict[str, JointTopic], name: str, joints: tuple[str, ...], damage: Damage) -> JointTopic | None:
    """The topic, its columns in the order of `joints`."""
    topic = _chosen(topics, name, damage)
    if topic is None or not topic.stamp or not topic.wanted:
        return None
    missing = [joint for joint in joints if joint not in topic.wanted]
    if missing:
        damage.note(f"{topic.topic} does not name {', '.join(missing)}; it is not used")
        return None
    if topic.wanted != joints:
        columns = [topic.wanted.index(joint) for joint in joints]
        topic.values = [[part[:, columns] for part in piece] for piece in topic.values]
        topic.wanted = joints
    return topic


def _held(topic: JointTopic | None, stamp: np.ndarray, n: int, fields: int, damage: Damage) -> list[np.ndarray]:
    """The last message at or before each stamp (N,): fields x (N, n); NaN before the first, and where there is no topic."""
    if topic is None:
        return [np.broadcast_to(np.float64(np.nan), (len(stamp), n))] * fields
    own = np.concatenate(topic.stamp)
    parts = [topic.joined(k) for k in range(fields)]
    if len(own) == len(stamp) and np.array_equal(own, stamp):
        return parts
    if np.any(np.diff(own) < 0):
        order = np.argsort(own, kind="stable")
        own, parts = own[order], [part[order] for part in parts]
        damage.note(f"messages on {topic.topic} are not in the order of their stamps; they were read in that order")
    place = np.searchsorted(own, stamp, side="right") - 1
    out = []
    for part in parts:
        if part.strides[0]:
            part = part[np.maximum(place, 0)]
            part[place < 0] = np.nan
            out.append(part)
        else:
            out.append(np.broadcast_to(np.float64(np.nan), (len(stamp), n)))
    return out
