"""Other software reads our recordings (the reference MCAP reader, mcap-ros2-support, rosbags), and we read a bag by rosbags."""

import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs import Recorder, read_log
from logs.about import About
from logs.convert import write_log
from logs.recover import recovered
from logs.schemas import FRAME, SCHEMAS, TOPICS, UNITS
from sim.joint_state import JointState

NAMES = ("shoulder", "elbow", "wrist_with_a_long_name")
COUNT = 300


@pytest.fixture
def recording(tmp_path):
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.normal(0, 1e-3, (COUNT, 3)), axis=0)
    about = About("<robot name='servo3'/>", {"arm/arm.toml": b"name = 'servo3'", "cell.toml": b"a cell"})
    with Recorder(tmp_path / "a.mcap", NAMES, {"arm": "servo3"}, about, wall_clock=lambda: 1_700_000_000 * 10**9) as recorder:
        for k in range(COUNT):
            nothing = np.full(3, np.nan)
            recorder.write(
                JointState(0.002 * k, 100 + 0.002 * k, x[k], x[k] + 1, nothing, x[k] + 3, nothing), x[k], x[k], nothing
            )
        recorder.event(30, "guard", "a warning", 100.1)
    return tmp_path / "a.mcap", x


def test_the_reference_reader_and_ros2_decoder(recording):
    path, x = recording
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary.statistics.message_count == 3 * COUNT + 2
        assert {channel.topic for channel in summary.channels.values()} == set(TOPICS)
        assert len(summary.chunk_indexes) >= 1
        assert {record.name for record in reader.iter_metadata()} == {"recording", "device_clock"}
        assert {channel.topic: channel.metadata for channel in summary.channels.values()} == UNITS
        attached = {item.name: (item.media_type, item.data) for item in reader.iter_attachments()}
        assert attached == {
            "arm/arm.toml": ("application/toml", b"name = 'servo3'"),
            "cell.toml": ("application/toml", b"a cell"),
        }
        (described,) = [decoded.data for *_, decoded in reader.iter_decoded_messages(topics=["/robot_description"])]
        assert described == "<robot name='servo3'/>"
        states = [decoded for _, channel, _, decoded in reader.iter_decoded_messages(topics=["/joint_states"])]
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for topic in TOPICS:
            assert len(list(reader.iter_decoded_messages(topics=[topic]))) == (
                1 if topic in ("/events", "/robot_description") else COUNT
            )
    np.testing.assert_array_equal([state.position for state in states], x)
    assert tuple(states[0].name) == NAMES
    assert list(states[0].effort) == []
    assert states[5].header.stamp.sec == 1_700_000_000  # wall time, although the device clock starts at 100 s
    assert read_log(path).t_origin == 100 * 10**9
    assert states[5].header.stamp.nanosec == 10_000_000


@pytest.mark.parametrize("base", ["base", ""])
def test_messages_name_the_link_that_the_joints_stand_on(tmp_path, base):
    """In a finished, a recovered and an imported recording. A frame that is not a valid name is left out."""
    about = About(f'<robot name="a"><link name="{base}"/><link name="upper"/></robot>' if base else "")
    x = np.zeros(3)
    for name in ("ended.mcap", "killed.mcap"):
        recorder = Recorder(tmp_path / name, NAMES, {"arm": "servo3"}, about)
        for k in range(50):
            recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x), x, x, x)
        journal = (tmp_path / name).read_bytes()
        recorder.close()
        if name == "killed.mcap":
            (tmp_path / name).write_bytes(journal)
    assert recovered(tmp_path / "killed.mcap") is not None
    log = read_log(tmp_path / "ended.mcap")
    write_log(log, tmp_path / "imported.mcap", "clean", {})
    write_log(replace(log, metadata=log.metadata | {FRAME: "no name" * 100}), tmp_path / "odd.mcap", "clean", {})
    for name, frame in (("ended.mcap", base), ("killed.mcap", base), ("imported.mcap", base), ("odd.mcap", "")):
        with (tmp_path / name).open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            seen = {
                decoded.header.frame_id
                for *_, decoded in reader.iter_decoded_messages(topics=["/joint_states", "/joint_commands"])
            }
        assert seen == {frame}
        assert len(read_log(tmp_path / name)) == 50


def test_rosbags_reads_it_as_a_bag(recording):
    path, x = recording
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(SCHEMAS["calib_msgs/msg/JointDiagnostics"], "calib_msgs/msg/JointDiagnostics"))
    with AnyReader([path], default_typestore=store) as reader:
        assert {connection.topic for connection in reader.connections} == set(TOPICS)
        messages = {topic: [] for topic in TOPICS}
        for connection, _, raw in reader.messages():
            messages[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    np.testing.assert_array_equal([state.position for state in messages["/joint_states"]], x)
    np.testing.assert_array_equal([reading.current for reading in messages["/joint_diagnostics"]], x + 3)
    assert (messages["/events"][0].level, messages["/events"][0].msg) == (30, "a warning")


def test_a_bag_written_by_rosbags_with_other_topics_in_it(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    make = store.types
    folder = tmp_path / "bag"
    x = np.linspace(0, 1, 200)[:, None] * np.array([1.0, 2.0])
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/ur10e/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        other = writer.add_connection("/rosout", "std_msgs/msg/String", typestore=store)
        for k in range(200):
            stamp = make["builtin_interfaces/msg/Time"](1000, 2_000_000 * k)
            header = make["std_msgs/msg/Header"](stamp, "base_link")
            state = make["sensor_msgs/msg/JointState"](header, ["b", "a"], x[k], np.array([]), x[k] * 3)
            at = 1_700_000_000 * 10**9 + 2_000_000 * k
            writer.write(joints, at, store.serialize_cdr(state, "sensor_msgs/msg/JointState"))
            writer.write(other, at, store.serialize_cdr(make["std_msgs/msg/String"]("chatter" * k), "std_msgs/msg/String"))
    log = read_log(folder, ("a", "b"))
    np.testing.assert_array_equal(log.q, x[:, ::-1])
    np.testing.assert_array_equal(log.tau, x[:, ::-1] * 3)
    assert np.isnan(log.dq).all()
    assert log.t[-1] == pytest.approx(0.398)


def test_the_schemas_are_the_ones_of_ros2():
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind in ("sensor_msgs/msg/JointState", "rcl_interfaces/msg/Log"):
        assert get_types_from_msg(SCHEMAS[kind], kind)[kind] == store.fielddefs[kind]


def test_metadata_is_text_that_other_tools_show(recording):
    path, _ = recording
    with path.open("rb") as file:
        record = next(record for record in make_reader(file).iter_metadata() if record.name == "recording")
    assert record.metadata["state"] == "clean"
    assert json.loads(record.metadata["joint_names"]) == list(NAMES)
