"""Recordings as other programs write them: MCAP files by the reference writer, CSV files in the form of ur_rtde's recorder."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs.schemas import COMMANDS, DIAGNOSTICS, EVENTS, SCHEMAS, STATES, TOPICS

JOINTS = ("shoulder", "elbow", "wrist")


@pytest.fixture
def joints() -> tuple[str, ...]:
    return JOINTS


@pytest.fixture
def real_data() -> Path:
    """The folder of real recordings, which stay outside the repository."""
    folder = os.environ.get("ARM_CALIB_DATA")
    if not folder:
        pytest.skip("real recordings are not here: set ARM_CALIB_DATA to their folder")
    return Path(folder)


STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(get_types_from_msg(SCHEMAS["calib_msgs/msg/JointDiagnostics"], "calib_msgs/msg/JointDiagnostics"))


def joint_message(stamp: int, names: Iterable[str], **arrays: Iterable[float]) -> dict:
    header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""}
    return {"header": header, "name": list(names), **{key: list(value) for key, value in arrays.items()}}


def cdr(kind: str, message: dict) -> bytes:
    """The message as the rosbags library writes it: a serialiser that shares no code with ours."""
    make = STORE.types
    stamp = make["builtin_interfaces/msg/Time"]
    if kind == "rcl_interfaces/msg/Log":
        message = message | {"stamp": stamp(**message["stamp"])}
    else:
        header = message["header"]
        message = {
            key: np.array(value, dtype=float) if key not in ("header", "name") else value for key, value in message.items()
        }
        message["header"] = make["std_msgs/msg/Header"](stamp(**header["stamp"]), header["frame_id"])
    return bytes(STORE.serialize_cdr(make[kind](**message), kind))


@pytest.fixture
def motion() -> tuple[np.ndarray, np.ndarray]:
    """Stamps (N,) in ns at 500 Hz and angles (N, 3) in rad."""
    k = np.arange(400)
    return 1_700_000_000_000_000_000 + k * 2_000_000, 0.5 * np.sin(0.01 * k[:, None] * np.array([1.0, 1.3, 1.7]))


@pytest.fixture
def mcap_bytes(motion: tuple[np.ndarray, np.ndarray]) -> Callable[..., bytes]:
    """An MCAP file by the reference writer; `change(k, message)` may replace or drop (None) the k-th joint state."""
    stamps, q = motion

    def make(change: Callable[[int, dict], dict | None] = lambda k, message: message, **options: object) -> bytes:
        stream = io.BytesIO()
        writer = Writer(stream, **{"compression": CompressionType.ZSTD, "chunk_size": 20_000} | options)
        writer.start("ros2", "a test")
        schemas = {kind: writer.register_schema(kind, "ros2msg", text.encode()) for kind, text in SCHEMAS.items()}
        channels = {topic: writer.register_channel(topic, "cdr", schemas[kind]) for topic, kind in TOPICS.items()}

        def add(topic: str, message: dict, stamp: int, k: int) -> None:
            writer.add_message(channels[topic], stamp + 5_000_000, cdr(TOPICS[topic], message), stamp, k)

        for k, (stamp, angles) in enumerate(zip(stamps.tolist(), q, strict=True)):
            message = change(k, joint_message(stamp, JOINTS, position=angles, velocity=angles + 1, effort=angles + 2))
            if message is not None:
                add(STATES, message, stamp, k)
            add(COMMANDS, joint_message(stamp, JOINTS[::-1], position=angles[::-1] + 3, velocity=[], effort=[]), stamp, k)
            if k % 20 == 0:
                add(DIAGNOSTICS, joint_message(stamp, JOINTS, current=angles * 10, temperature=[30.0 + k] * 3), stamp, k)
            if k == 100:
                text = {
                    "stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9},
                    "level": 20,
                    "name": "test",
                    "msg": "started",
                }
                add(EVENTS, text | {"file": "", "function": "", "line": 0}, stamp, k)
        writer.finish()
        return stream.getvalue()

    return make


@pytest.fixture
def csv_text() -> Callable[..., str]:
    """A CSV file as ur_rtde's recorder writes it, `rows` samples long; `extra` columns hold 7."""

    def make(rows: int = 50, extra: tuple[str, ...] = ("target_current_0", "target_moment_0")) -> str:
        names = [f"{stem}_{j}" for stem in ("actual_q", "actual_qd", "actual_current") for j in range(6)]
        lines = [",".join(["timestamp", *names, *extra])]
        for k in range(rows):
            angles = 0.1 * np.sin(0.02 * k + np.arange(18))
            values = [357.7 + 0.002 * k, *angles, *[7.0] * len(extra)]
            lines.append(",".join(f"{value:.4f}" for value in values))
        return "\n".join(lines) + "\n"

    return make
