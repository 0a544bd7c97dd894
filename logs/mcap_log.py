"""MCAP files with ROS 2 joint messages as a Log: our own recordings, and rosbag2 files that hold other topics too."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.assembly import assembled
from logs.cdr import CdrError, log_message
from logs.damage import Damage
from logs.finish import killed_sentence
from logs.joint_topic import JointTopic
from logs.log import Log, State
from logs.mcap_records import MESSAGE, Batch, Channel
from logs.mcap_stream import McapStream
from logs.recover import is_recording
from logs.schemas import EVENTS, FAILURE, RECORDING, SCHEMAS, STATES
from sim.errors import EmptyLog

MAX_EVENTS = 100_000
STATE_WORDS = ("clean", "open", "aborted", "killed")
FIELDS = {"sensor_msgs/msg/JointState": 3, "calib_msgs/msg/JointDiagnostics": 2}


@dataclass(frozen=True)
class Scanned:
    """Result of one pass over a recording: messages by topic, events, metadata records, and how the recording ended."""

    topics: dict[str, JointTopic]
    events: list[tuple[int, int, str, str]]
    metadata: dict[str, dict[str, str]]
    state: State


def read_mcap(paths: list[Path], joint_names: tuple[str, ...] | None, damage: Damage) -> Log:
    """Return one log of the joint messages in `paths` (the parts of a split recording, in order)."""
    scan = scanned(paths, joint_names, damage)
    return assembled(scan.topics, scan.events, scan.metadata, scan.state, joint_names, damage)


def scanned(
    paths: list[Path], joint_names: tuple[str, ...] | None, damage: Damage, after: Callable[[dict[str, JointTopic]], None] | None = None
) -> Scanned:  # fmt: skip
    """Read all messages of `paths`; `after` gets the topics after each batch, and may take out what need not stay in memory."""
    topics: dict[str, JointTopic] = {}
    events: list[tuple[int, int, str, str]] = []
    metadata: dict[str, dict[str, str]] = {}
    ended, unsealed, killed = True, 0, None
    for path in paths:
        dead = killed_now(path)  # checked before reading: whatever writes meanwhile is alive
        try:
            with path.open("rb") as file:
                stream = McapStream(file, path.stat().st_size, damage)
                for batch in stream.batches():
                    take(batch, stream.channels, topics, events, joint_names, damage)
                    if after is not None:
                        after(topics)
        except OSError as error:
            raise damage.refuse("file", f"cannot be read ({error.strerror})", "give a readable recording") from error
        metadata |= stream.metadata
        ended &= stream.ended
        unsealed += stream.unsealed
        if stream.journal:
            killed = dead
    topic = topics.get(STATES)
    check_count(metadata.get(RECORDING, {}), topic.taken + sum(topic.others.values()) if topic else 0, damage)
    known = metadata.get(RECORDING, {}).get("state") in STATE_WORDS
    if known and not topics and (ended or killed) and not damage.count:
        why = metadata[RECORDING].get("end_reason") or "its program was killed"
        raise EmptyLog(f"{damage.path}: holds no sample: the motion had not begun ({why}); record it again")
    killed_text = killed_sentence(topic.taken if topic else 0, topic.last_host if topic else None)
    state = recording_state(metadata, ended, killed, damage, killed_text)
    if unsealed:
        damage.note(f"the last {unsealed} bytes are an incomplete sample and are left out")
    return Scanned(topics, events, metadata, state)


def check_count(recording: dict[str, str], found: int, damage: Damage) -> None:
    """Report a finished recording that states another number of samples than `found`."""
    stated = recording.get("samples")
    if stated is not None and stated != str(found):
        damage.report("metadata record 'recording'", f"the recording says {stated} samples, {found} survive")


def killed_now(path: Path) -> bool:
    """Whether the program that wrote the journal at `path` is gone; False where this is unknown."""
    try:
        return is_recording(path) is False
    except OSError:
        return False


def recording_state(
    metadata: dict[str, dict[str, str]], ended: bool, killed: bool | None, damage: Damage, held: str = ""
) -> State:  # fmt: skip
    """Return how the recording ended; anything but a clean end or a kill is refused unless a partial file is accepted.

    killed: for a journal, whether its program is gone; None for a finished file. held: sentence about the content of such a
    journal.
    """
    recording, failure = metadata.get(RECORDING, {}), metadata.get(FAILURE, {}).get("reason", "")
    if killed is None:
        if not ended:
            damage.report("end of file", "the MCAP footer is missing: the file is cut")
            return State.CUT
        if damage.count:
            return State.CUT
        word = recording.get("state", "clean" if not recording else "")
    else:
        word = "aborted" if failure else "killed" if killed else "open"
    if word not in STATE_WORDS:
        raise damage.refuse(
            "metadata record 'recording'", f"state {word!r}; clean, open, aborted and killed are known", "record it again"
        )
    state = State[word.upper()]
    if state is State.KILLED:
        damage.note(recording.get("end_reason") or held or state.value)
    elif state is not State.CLEAN:
        fault = f"{state.value} ({failure or recording.get('end_reason') or 'no reason was written'})"
        if not damage.accept_partial:
            remedy = "wait until it has ended" if state is State.OPEN else "record it again"
            raise damage.refuse("state", fault, f"{remedy}, or use what there is with --accept-partial")
        damage.note(fault)
    return state


def take(
    batch: Batch, channels: dict[int, Channel], topics: dict[str, JointTopic], events: list[tuple[int, int, str, str]],
    joint_names: tuple[str, ...] | None, damage: Damage,
) -> None:  # fmt: skip
    heads = batch.heads
    for number in batch.counts:
        channel = channels.get(number)
        if channel is None:
            continue
        kind = channel.schema.replace("sensor_msgs/JointState", "sensor_msgs/msg/JointState")
        mine = heads["channel"] == number
        if kind in FIELDS:
            if channel.topic not in topics:
                check_schema(channel, kind, damage)
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


def check_schema(channel: Channel, kind: str, damage: Damage) -> None:
    """Refuse a topic whose encoding or fields are not those of its type: the name does not determine the layout of the bytes."""
    if channel.encoding != "cdr" or channel.schema_encoding != "ros2msg":
        raise damage.refuse(
            f"topic {channel.topic}", f"encoding {channel.encoding!r} with schema {channel.schema_encoding!r}",
            "only joint messages in CDR with a ros2msg schema are read",
        )  # fmt: skip
    if _fields(channel.definition) != _fields(SCHEMAS[kind]):
        raise damage.refuse(
            f"topic {channel.topic}", f"its schema {channel.schema} has fields other than ROS 2's own",
            f"convert it to {'; '.join(_fields(SCHEMAS[kind]))}",
        )  # fmt: skip


def _fields(definition: str) -> list[str]:
    """Field lines of a ros2msg definition, comments and blank space removed."""
    top = re.split(r"^=+\s*$", definition, maxsplit=1, flags=re.MULTILINE)[0]
    lines = (" ".join(line.split("#", 1)[0].split()) for line in top.splitlines())
    return [line.replace("std_msgs/msg/Header", "std_msgs/Header").replace("builtin_interfaces/msg/", "builtin_interfaces/")
            for line in lines if line]  # fmt: skip
