"""An MCAP file for viewers, derived from a recording: the moving arm, and the measured torque beside the predicted one."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from logs.encode import JointEncoder, text_body
from logs.finish import put_in_place, write_file
from logs.schemas import DESCRIPTION, HEADER, RULE, SCHEMAS, STATES, UNITS

PREDICTED, MISSING, TRANSFORMS = "/prediction/joint_states", "/prediction/missing", "/tf"
TF_RATE = 30.0  # Hz: what a viewer draws
JOINT_STATE, TF_MESSAGE = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"
TF_SCHEMA = f"""geometry_msgs/TransformStamped[] transforms
{RULE}
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
{RULE}
MSG: geometry_msgs/Transform
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
{RULE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{RULE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{HEADER}"""


def write_prediction(
    path: Path, stamps: np.ndarray, joint_names: Sequence[str], q: np.ndarray, dq: np.ndarray, tau: np.ndarray, tau_hat: np.ndarray,
    urdf: str, frames: Sequence[tuple[str, str]], poses: np.ndarray,
) -> None:  # fmt: skip
    """Write the new file `path` with measured, predicted and missing torque and, where there is a `urdf`, the moving arm.

    /joint_states as measured, /prediction/joint_states with tau_hat as effort, /prediction/missing with tau - tau_hat; with a
    `urdf`, also /robot_description and /tf (at TF_RATE).

    stamps (N,) ns since 1970; q dq tau tau_hat (N, n) rad, rad/s, N m; frames (F) pairs (parent, child) and poses (N, F, 7):
    position m and quaternion x y z w of the child in the parent.
    """
    encoder = JointEncoder(joint_names, frames[0][0] if frames else "")
    nothing = np.full(len(joint_names), np.nan)
    step = max(1, round(1e9 / TF_RATE / float(np.median(np.diff(stamps))))) if len(stamps) > 1 else 1
    transforms = TransformEncoder(frames)

    def body(writer: Writer) -> dict[int, int]:
        joints = writer.register_schema(JOINT_STATE, "ros2msg", SCHEMAS[JOINT_STATE].encode())
        units = {topic: writer.register_channel(topic, "cdr", joints, UNITS[STATES]) for topic in (STATES, PREDICTED, MISSING)}
        counts = dict.fromkeys(units.values(), len(stamps))
        tf = None
        if urdf:
            text = writer.register_schema("std_msgs/msg/String", "ros2msg", SCHEMAS["std_msgs/msg/String"].encode())
            described = writer.register_channel(DESCRIPTION, "cdr", text, UNITS[DESCRIPTION])
            writer.add_message(described, int(stamps[0]), text_body(urdf), int(stamps[0]), 0)
            schema = writer.register_schema(TF_MESSAGE, "ros2msg", TF_SCHEMA.encode())
            tf = writer.register_channel(TRANSFORMS, "cdr", schema, {"translation": "m"})
            counts |= {described: 1, tf: len(stamps[::step])}
        for k, stamp in enumerate(stamps.tolist()):
            sources = (
                (STATES, q[k], dq[k], tau[k]),
                (PREDICTED, q[k], dq[k], tau_hat[k]),
                (MISSING, nothing, nothing, tau[k] - tau_hat[k]),
            )
            for topic, *arrays in sources:
                data = encoder.body(stamp, [np.ascontiguousarray(array) for array in arrays])
                writer.add_message(units[topic], stamp, data, stamp, k)
            if tf is not None and k % step == 0:
                writer.add_message(tf, stamp, transforms.body(stamp, poses[k]), stamp, k // step)
        return counts

    part = path.with_name(path.name + ".part")
    write_file(part, body)
    put_in_place(part, path)


class TransformEncoder:
    """Bodies of `tf2_msgs/msg/TFMessage` for one set of frames: constant bytes, stamps and numbers (CDR, little endian)."""

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        out = bytearray(struct.pack("<I", len(frames)))
        self._stamps: list[int] = []
        self._numbers: list[int] = []
        for parent, child in frames:
            out += bytes(-len(out) % 4)
            self._stamps.append(4 + len(out))
            out += bytes(8)
            for name in (parent, child):
                raw = name.encode() + b"\x00"
                out += bytes(-len(out) % 4) + struct.pack("<I", len(raw)) + raw
            out += bytes(-len(out) % 8)
            self._numbers.append(4 + len(out))
            out += bytes(56)
        self._body = bytearray(b"\x00\x01\x00\x00" + out)

    def body(self, stamp: int, poses: np.ndarray) -> bytes:
        """The message at `stamp` ns; poses (F, 7)."""
        for at, number, pose in zip(self._stamps, self._numbers, poses, strict=True):
            struct.pack_into("<iI", self._body, at, stamp // 1_000_000_000, stamp % 1_000_000_000)
            struct.pack_into("<7d", self._body, number, *pose)
        return bytes(self._body)
