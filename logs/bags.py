"""ROS 2 bags in SQLite (.db3) and ROS 1 bags (.bag), opened with rosbags; joint messages are decoded like those of MCAP files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from logs.assembly import assembled
from logs.damage import Damage
from logs.joint_topic import JointTopic
from logs.log import Log, State
from logs.mcap_log import FIELDS, take
from logs.mcap_records import MESSAGE, Batch, Channel
from logs.schemas import SCHEMAS
from sim.errors import BadLog

SQLITE, ROSBAG1 = b"SQLite format 3", b"#ROSBAG V2.0"
TOGETHER = 4096  # messages decoded at once
MAX_MESSAGE = 1 << 20  # bytes of a joint message


def is_sqlite_bag(path: Path) -> bool:
    """Whether `path` is a folder with .db3 files, plain or compressed, and no MCAP file."""
    return path.is_dir() and any(path.glob("*.db3*")) and not any(path.glob("*.mcap"))


def read_bag(path: Path, joint_names: tuple[str, ...] | None, damage: Damage) -> Log:
    """Return the joint messages of a bag as a log; BadLog states what is wrong with it."""
    topics: dict[str, JointTopic] = {}
    channels: dict[int, Channel] = {}
    try:
        for batch in _batches(path, channels, damage):
            take(batch, channels, topics, [], joint_names, damage)
    except BadLog:
        raise
    except Exception as error:  # rosbags trusts what the file declares, and fails on damage in many ways
        fault = f"rosbags cannot read further: {type(error).__name__}: {str(error)[:160]}"
        if not topics or not damage.accept_partial:
            raise damage.refuse(
                "bag", fault, "check it with `ros2 bag info`, or read what survives with `calib import`"
            ) from error
        damage.report("bag", fault)
    return assembled(topics, [], {}, State.CUT if damage.count else State.CLEAN, joint_names, damage)


def _batches(path: Path, channels: dict[int, Channel], damage: Damage) -> Iterator[Batch]:
    heads: list[tuple[int, int, bytes]] = []
    for number, stamp, data in _messages(path, channels):
        if len(data) > MAX_MESSAGE:
            damage.report(f"message on {channels[number].topic}", f"{len(data)} bytes")
            continue
        heads.append((number, stamp, bytes(data)))
        if len(heads) == TOGETHER:
            yield _batch(heads)
            heads = []
    if heads:
        yield _batch(heads)


def _batch(messages: list[tuple[int, int, bytes]]) -> Batch:
    """Messages as records of an MCAP chunk."""
    head = np.zeros(1, dtype=MESSAGE)
    parts, starts, at = [], [], 0
    for number, stamp, data in messages:
        head[0] = (5, MESSAGE.itemsize - 9 + len(data), number, 0, stamp, stamp)
        parts += [head.tobytes(), data]
        starts.append(at)
        at += MESSAGE.itemsize + len(data)
    return Batch(b"".join(parts), np.array(starts), "bag")


def _messages(path: Path, channels: dict[int, Channel]) -> Iterator[tuple[int, int, bytes]]:
    """Yield the channel number, the reception time (ns) and the CDR of every joint message.

    The definitions in the bag are not used: the layout of a joint message is known, and no code is generated from a file.
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    ros1 = path.is_file() and path.suffix == ".bag"
    ros_1, ros_2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)

    def as_ros_2(raw: bytes, kind: str) -> memoryview:
        message: Any = ros_1.deserialize_ros1(raw, kind)
        message.header = ros_2.types["std_msgs/msg/Header"](
            message.header.stamp, message.header.frame_id
        )  # without its counter
        return ros_2.serialize_cdr(message, kind)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rosbag1.Reader(path) if ros1 else rosbag2.Reader(path) as reader:
            mine: list[Any] = [c for c in reader.connections if c.msgtype in FIELDS]
            numbers: dict[str, int] = {}
            for connection in mine:
                number = numbers.setdefault(connection.topic, len(numbers) + 1)
                kind = connection.msgtype
                channels[number] = Channel(connection.topic, "cdr", kind, "ros2msg", SCHEMAS[kind])
            for connection, stamp, raw in reader.messages(mine) if mine else ():
                data = as_ros_2(raw, connection.msgtype) if ros1 else raw
                yield numbers[connection.topic], stamp, bytes(data)
