"""ROS 2 bags in SQLite and ROS 1 bags, written by another library: the log holds exactly the values that were written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from logs import read_log
from sim.errors import BadLog
from tests.logs.conftest import JOINTS

KIND = "sensor_msgs/msg/JointState"


def states(store, motion, ros1: bool = False):
    make = store.types
    for k, (stamp, angles) in enumerate(zip(motion[0].tolist(), motion[1], strict=True)):
        time = make["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        header = make["std_msgs/msg/Header"](k, time, "") if ros1 else make["std_msgs/msg/Header"](time, "")
        yield stamp + 300_000, make[KIND](header, list(JOINTS), angles, angles + 1, angles + 2)


def sqlite_bag(folder: Path, motion, pack: bool = False) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = rosbag2.Writer(folder, version=8, storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    if pack:
        writer.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    with writer:
        other = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        mine = writer.add_connection("/joint_states", KIND, typestore=store)
        for stamp, message in states(store, motion):
            writer.write(mine, stamp, store.serialize_cdr(message, KIND))
        writer.write(other, stamp, store.serialize_cdr(store.types["std_msgs/msg/String"]("hello"), "std_msgs/msg/String"))
    return folder


@pytest.mark.parametrize("pack", [False, True])
def test_a_bag_in_sqlite(tmp_path, motion, pack) -> None:
    bag = sqlite_bag(tmp_path / "bag", motion, pack)
    log = read_log(bag, ("wrist", "elbow", "shoulder"))
    np.testing.assert_array_equal(log.q, motion[1][:, ::-1])
    np.testing.assert_array_equal(log.tau, motion[1][:, ::-1] + 2)
    np.testing.assert_allclose(log.t, (motion[0] - motion[0][0]) * 1e-9, atol=1e-12)
    assert log.t_host_origin == motion[0][0] + 300_000
    if not pack:
        file = next(bag.glob("*.db3"))
        np.testing.assert_array_equal(read_log(file, JOINTS).q, motion[1])


def test_a_bag_of_ros_1(tmp_path, motion) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with rosbag1.Writer(tmp_path / "a.bag") as writer:
        mine = writer.add_connection("/robot/joint_states", KIND, typestore=store)
        for stamp, message in states(store, motion, ros1=True):
            writer.write(mine, stamp, store.serialize_ros1(message, KIND))
    log = read_log(tmp_path / "a.bag", JOINTS)
    np.testing.assert_array_equal(log.q, motion[1])
    np.testing.assert_array_equal(log.dq, motion[1] + 1)


def test_damage_and_emptiness(tmp_path, motion) -> None:
    bag = sqlite_bag(tmp_path / "bag", motion)
    with pytest.raises(BadLog, match="no message on /joint_states with the joints a, b"):
        read_log(bag, ("a", "b"))
    file = next(bag.glob("*.db3"))
    content = bytearray(file.read_bytes())
    for seed in range(60):
        rng = np.random.default_rng(seed)
        hurt = bytearray(content)
        for at in rng.integers(16, len(hurt), 40):
            hurt[at] = rng.integers(256)
        file.write_bytes(hurt[: rng.integers(100, len(hurt))] if seed % 3 else hurt)
        for partial in (False, True):
            try:
                log = read_log(file, JOINTS, accept_partial=partial)
            except BadLog:
                continue
            assert np.isfinite(log.q).all()
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(500))
    with pytest.raises(BadLog, match="rosbags cannot read further"):
        read_log(tmp_path / "x.bag")
