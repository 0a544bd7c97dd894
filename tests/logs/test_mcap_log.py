"""MCAP recordings as arrays: joints by name, in bulk or message by message, and what is refused."""

import io

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from logs import State, joint_topic, read_log
from logs.schemas import SCHEMAS
from sim.errors import BadLog
from tests.logs.conftest import JOINTS, cdr, joint_message


def write(path, data):
    path.write_bytes(data)
    return path


def check(log, motion):
    stamps, q = motion
    np.testing.assert_array_equal(log.q, q)
    np.testing.assert_array_equal(log.dq, q + 1)
    np.testing.assert_array_equal(log.tau, q + 2)
    np.testing.assert_array_equal(log.q_cmd, q + 3)
    assert np.isnan(log.dq_cmd).all()
    np.testing.assert_allclose(log.t, (stamps - stamps[0]) * 1e-9, rtol=0, atol=1e-12)
    assert log.t_origin == stamps[0]
    assert log.t_host_origin == stamps[0] + 5_000_000
    held = np.arange(len(q)) // 20 * 20
    np.testing.assert_array_equal(log.current[:381:20], 10 * q[:381:20])  # slower readings are interpolated linearly
    np.testing.assert_allclose(log.current[10:381:20], 5 * (q[:380:20] + q[20:400:20]), rtol=0, atol=1e-9)
    assert np.isnan(log.current[381:]).all()
    np.testing.assert_array_equal(log.temperature[:, 0], 30.0 + held)
    assert [(event.level, event.name, event.message) for event in log.events] == [(20, "test", "started")]
    assert log.events[0].t == pytest.approx(0.2)


@pytest.mark.parametrize(
    "options",
    [
        {}, {"compression": CompressionType.LZ4}, {"compression": CompressionType.NONE}, {"use_chunking": False},
        {"enable_data_crcs": True}, {"chunk_size": 100}, {"repeat_channels": False},
    ],
    ids=str,
)  # fmt: skip
def test_every_form_of_the_container_reads_alike(tmp_path, mcap_bytes, motion, joints, options):
    log = read_log(write(tmp_path / "a.mcap", mcap_bytes(**options)))
    assert log.joint_names == joints
    assert log.state is State.CLEAN
    assert log.findings == ("readings on /joint_diagnostics have their own stamps; they were interpolated on the device clock",)
    check(log, motion)


def test_joints_are_matched_by_name(tmp_path, mcap_bytes, motion):
    path = write(tmp_path / "a.mcap", mcap_bytes())
    log = read_log(path, ["wrist", "shoulder"])
    np.testing.assert_array_equal(log.q, motion[1][:, [2, 0]])
    np.testing.assert_array_equal(log.q_cmd, motion[1][:, [2, 0]] + 3)
    with pytest.raises(BadLog, match="no message on /joint_states with the joints finger"):
        read_log(path, ["finger"])
    with pytest.raises(BadLog, match="joints finger are missing"):
        read_log(path, ["wrist", "finger"])


def test_every_message_laid_out_differently_takes_the_slow_path(tmp_path, mcap_bytes, motion):
    def change(k, message):
        message["header"]["frame_id"] = "x" * (k % 31)
        if k % 3 == 1:
            for key in ("name", "position", "velocity", "effort"):
                message[key] = message[key][::-1]
        if k % 5 == 2:
            message["header"]["frame_id"] = f"{k:04}"
        return message

    check(read_log(write(tmp_path / "a.mcap", mcap_bytes(change))), motion)


def test_an_array_that_is_not_reported_is_nan(tmp_path, mcap_bytes, motion):
    log = read_log(write(tmp_path / "a.mcap", mcap_bytes(lambda k, message: message | {"effort": []})))
    assert np.isnan(log.tau).all()
    assert log.tau.shape == log.q.shape
    half = read_log(write(tmp_path / "b.mcap", mcap_bytes(lambda k, m: m | {"effort": []} if k % 2 else m)))
    np.testing.assert_array_equal(np.isnan(half.tau[:, 0]), np.arange(400) % 2 == 1)


def test_messages_of_another_device_are_left_alone(tmp_path, mcap_bytes, motion):
    def change(k, message):
        return message if k % 2 else message | {"name": ["a", "b", "c"]}

    log = read_log(write(tmp_path / "a.mcap", mcap_bytes(change)), ["shoulder", "elbow", "wrist"])
    np.testing.assert_array_equal(log.q, motion[1][1::2])
    assert any("200 messages on /joint_states are about other joints" in finding for finding in log.findings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m | {"position": m["position"][:2]}, "an array of 2 values for 3 joint names"),
        (lambda m: m | {"name": ["shoulder", "elbow", "elbow"]}, "joint names repeat"),
        (lambda m: m | {"name": ["shoulder", "elbow", "claw"]}, "joints wrist are missing"),
        (lambda m: m | {"position": [0.0, float("nan"), 0.0]}, r"sample 7 at 0.0140 s, q of elbow: nan rad"),
        (lambda m: m | {"position": [0.0, float("inf"), 0.0]}, "inf rad is not a reading"),
        (lambda m: m | {"position": []}, "nan rad is not a reading"),
        (lambda m: m | {"position": [m["position"][0], m["position"][1] + 2 * np.pi, 0.0]}, "within 100 rad/s"),
        (lambda m: m | {"effort": [0.0, 1e9, 0.0]}, r"tau of elbow: 1e\+09 N m is not a reading"),
        (lambda m: m | {"header": {"stamp": {"sec": 1_700_000_000, "nanosec": 2_000_000_000}, "frame_id": ""}}, "over 1e9 ns"),
    ],
)
def test_a_bad_message_is_refused_and_may_be_left_out(tmp_path, mcap_bytes, motion, change, message):
    path = write(tmp_path / "a.mcap", mcap_bytes(lambda k, m: change(m) if k == 7 else m))
    with pytest.raises(BadLog, match=message):
        read_log(path)
    log = read_log(path, accept_partial=True)
    np.testing.assert_array_equal(log.q, np.delete(motion[1], 7, axis=0))
    assert log.findings


def test_time_running_back_is_refused_even_in_a_partial_file(tmp_path, mcap_bytes):
    def change(k, message):
        message["header"]["stamp"]["sec"] -= k == 50
        return message

    path = write(tmp_path / "a.mcap", mcap_bytes(change))
    for partial in (False, True):
        with pytest.raises(BadLog, match="sample 50: device time runs back"):
            read_log(path, accept_partial=partial)


def test_a_cut_file_says_so_and_keeps_what_came_before(tmp_path, mcap_bytes, motion):
    data = mcap_bytes()
    for size in (len(data) - 1, len(data) - 200, len(data) // 2):
        path = write(tmp_path / "a.mcap", data[:size])
        with pytest.raises(BadLog, match="the file is cut"):
            read_log(path)
        log = read_log(path, accept_partial=True)
        assert log.state is State.CUT
        np.testing.assert_array_equal(log.q, motion[1][: len(log)])
        assert len(log) > 100


def test_a_flipped_bit_is_found_and_its_chunk_left_out(tmp_path, mcap_bytes, motion):
    data = bytearray(mcap_bytes(compression=CompressionType.NONE))
    data[len(data) // 3] ^= 4
    path = write(tmp_path / "a.mcap", bytes(data))
    with pytest.raises(BadLog, match="the checksum of the content is wrong"):
        read_log(path)
    log = read_log(path, accept_partial=True)
    assert 200 < len(log) < 400
    assert np.isin(log.q[:, 0], motion[1][:, 0]).all()


def test_practice_cases(real_data):
    paths = sorted((real_data.parent / "cases").glob("case_00*/*.mcap"))
    if not paths:
        pytest.skip("the practice cases are not beside ARM_CALIB_DATA")
    for path in paths:
        log = read_log(path)
        assert log.n == 6
        assert log.state is State.CLEAN
        assert len(log) > 2000
        assert np.isfinite(log.q_cmd).all()


@pytest.mark.parametrize("block", [1, 7, 100])
def test_a_recording_of_many_blocks_reads_alike(tmp_path, mcap_bytes, motion, joints, block, monkeypatch):
    monkeypatch.setattr(joint_topic, "BLOCK", block)
    check(read_log(write(tmp_path / "a.mcap", mcap_bytes(chunk_size=100)), joints), motion)


def test_blocks_change_no_value_of_any_channel(tmp_path, mcap_bytes, motion, monkeypatch):
    whole = read_log(write(tmp_path / "a.mcap", mcap_bytes()))
    monkeypatch.setattr(joint_topic, "BLOCK", 3)
    again = read_log(tmp_path / "a.mcap")
    for name in ("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))


def test_messages_out_of_file_order_are_read_by_log_time(tmp_path, mcap_bytes, motion):
    """The threads of a recorder may swap messages, here two in ten. As in the official readers, log time gives the order."""
    stamps, q = motion
    swapped = np.arange(len(stamps))
    swapped[3::10], swapped[4::10] = swapped[4::10].copy(), swapped[3::10].copy()
    whole, mixed = tmp_path / "whole.mcap", tmp_path / "mixed.mcap"
    whole.write_bytes(mcap_bytes())
    mixed.write_bytes(reordered(stamps[swapped], q[swapped], swapped))
    log = read_log(mixed)
    np.testing.assert_array_equal(log.q, read_log(whole).q)
    np.testing.assert_allclose(log.t, 0.002 * np.arange(len(stamps)), atol=1e-9)
    assert log.findings == ("messages on /joint_states are not in the order of their log times; they were read in that order",)


def reordered(stamps, q, sequence):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros2", "a test")
    kind = "sensor_msgs/msg/JointState"
    channel = writer.register_channel("/joint_states", "cdr", writer.register_schema(kind, "ros2msg", SCHEMAS[kind].encode()))
    for stamp, angles, k in zip(stamps.tolist(), q, sequence.tolist(), strict=True):
        message = cdr(kind, joint_message(stamp, JOINTS, position=angles, velocity=[], effort=[]))
        writer.add_message(channel, stamp + 5_000_000, message, stamp, k)
    writer.finish()
    return stream.getvalue()


def test_losses_are_reported_by_sequence_numbers(tmp_path, motion):
    stamps, q = motion
    keep = np.r_[0:100, 103:250, 251:400]
    (tmp_path / "a.mcap").write_bytes(reordered(stamps[keep], q[keep], keep))
    findings = read_log(tmp_path / "a.mcap").findings
    assert "4 messages on /joint_states are missing by their sequence numbers, first after 0.1980 s" in findings
    (tmp_path / "b.mcap").write_bytes(reordered(stamps[keep], q[keep], 0 * keep))
    assert not any("sequence numbers" in finding for finding in read_log(tmp_path / "b.mcap").findings)


def test_a_bad_first_message_hides_no_joints(tmp_path, mcap_bytes):
    def change(k, message):
        return message if k else message | {"position": message["position"][:2], "effort": [0.0] * 4}

    log = read_log(write(tmp_path / "a.mcap", mcap_bytes(change)), accept_partial=True)
    assert (log.n, len(log)) == (3, 399)
