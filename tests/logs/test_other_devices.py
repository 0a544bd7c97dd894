"""Recordings with a gripper beside the arm, or without stamps: which device's samples are read, and on which clock."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from logs import read_log
from logs.convert import import_recording
from logs.schemas import SCHEMAS, STATES
from sim.errors import BadLog
from tests.logs.conftest import JOINTS, cdr, joint_message

STATE = "sensor_msgs/msg/JointState"
START, PERIOD = 1_700_000_000_000_000_000, 2_000_000
FINGER = ("finger",)
Source = tuple[str, tuple[str, ...]]  # topic and joints


def written(path: Path, sources: list[Source], count: int = 400, first: int = 0, stamped: bool = True) -> Path:
    """Write joint states of several devices in turn; the first of them starts `first` samples before the others."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=8_000)
    writer.start("ros2", "a test")
    schema = writer.register_schema(STATE, "ros2msg", SCHEMAS[STATE].encode())
    channels = {topic: writer.register_channel(topic, "cdr", schema) for topic, _ in sources}
    for k in range(count):
        at = START + k * PERIOD
        for topic, names in sources if k >= first else sources[:1]:
            q = 0.5 * np.sin(0.01 * k + np.arange(len(names)))
            message = joint_message(at if stamped else 0, names, position=q, velocity=q + 1, effort=q + 2)
            writer.add_message(channels[topic], at, cdr(STATE, message), at, 0)
    writer.finish()
    path.write_bytes(stream.getvalue())
    return path


@pytest.mark.parametrize("sources", [[(STATES, FINGER), (STATES, JOINTS)], [(STATES, JOINTS), (STATES, FINGER)]])
@pytest.mark.parametrize("names", [None, JOINTS, FINGER])
def test_arm_and_gripper_on_one_topic(tmp_path: Path, sources: list[Source], names: tuple[str, ...] | None) -> None:
    path, wanted = written(tmp_path / "a.mcap", sources), names or JOINTS
    done = import_recording(path, tmp_path / "out.mcap", joint_names=names)
    assert (done.log.joint_names, len(done.log)) == (wanted, 400)
    other = ", ".join(FINGER if wanted == JOINTS else JOINTS)
    assert any(f"400 messages on /joint_states are about other joints ({other})" in sentence for sentence in done.left_out)


def test_joints_of_no_one_device_are_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", [(STATES, FINGER), (STATES, JOINTS)], first=200)
    with pytest.raises(BadLog, match=r"several sets of joints: finger; shoulder, elbow, wrist; .*--arm"):
        read_log(path)
    assert len(read_log(path, JOINTS)) == 200
    path = written(tmp_path / "b.mcap", [(STATES, ("a", "b", "c")), (STATES, JOINTS)])
    with pytest.raises(BadLog, match="several sets of joints"):
        read_log(path)


@pytest.mark.parametrize("gripper", ["/gripper/joint_states", STATES])
def test_the_topic_that_has_the_joints(tmp_path: Path, gripper: str) -> None:
    path = written(tmp_path / "a.mcap", [(gripper, FINGER), ("/arm/joint_states", JOINTS)])
    assert read_log(path, JOINTS).joint_names == JOINTS
    assert read_log(path, FINGER).joint_names == FINGER
    with pytest.raises(BadLog, match="no message on /joint_states with the joints knee"):
        read_log(path, ("knee",))


def test_topics_under_several_names_are_listed_with_their_joints(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", [("/gripper/joint_states", FINGER), ("/arm/joint_states", JOINTS)])
    with pytest.raises(
        BadLog, match=r"/arm/joint_states with shoulder, elbow, wrist; /gripper/joint_states with finger; .*--arm"
    ):
        read_log(path)


def test_a_joint_beside_those_that_are_read_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", [(STATES, (*FINGER, *JOINTS))])
    assert any("also names finger: not read" in sentence for sentence in read_log(path, JOINTS).findings)


def test_without_stamps_the_log_times_are_the_instants(tmp_path: Path) -> None:
    log = read_log(written(tmp_path / "a.mcap", [(STATES, JOINTS)], stamped=False))
    np.testing.assert_allclose(log.t, 1e-9 * PERIOD * np.arange(400), atol=1e-12)
    assert log.t_origin == START
    assert np.isnan(log.t_host).all()
    assert any("all are 0" in sentence for sentence in log.findings)
