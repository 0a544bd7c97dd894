"""Recorded samples are read back, by us and by other readers; what cannot be recorded is refused."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader

from logs import Recorder, State, read_log
from sim.errors import BadLog, DeviceError
from sim.joint_state import JointState, Status
from tests.logs.written import NAMES, NAN, CountingDisk, record, sample


def test_what_was_written_is_read(tmp_path):
    path = tmp_path / "run" / "a.mcap"
    with Recorder(path, NAMES, {"arm": "servo3", "payload": {"mass": 1.5}}, wall_clock=lambda: 10**18) as recorder:
        record(recorder, 50)
        recorder.event(20, "motion", "friction of bb starts", 7.05)
        recorder.write(sample(50, Status.PROTECTIVE_STOP), NAN, NAN, NAN)
    log = read_log(path)
    assert log.state is State.CLEAN
    assert log.joint_names == NAMES
    assert log.findings == ()
    x = np.array([sample(k).q for k in range(51)])
    np.testing.assert_array_equal(log.q, x)
    np.testing.assert_array_equal(log.dq, x + 1)
    np.testing.assert_array_equal(log.tau, x + 2)
    np.testing.assert_array_equal(log.current, x + 3)
    np.testing.assert_array_equal(log.q_cmd[:50], x[:50] + 0.1)
    assert np.isnan(log.q_cmd[50]).all()
    assert np.isnan(log.temperature).all()
    np.testing.assert_allclose(log.t, 0.002 * np.arange(51), rtol=0, atol=1e-9)
    np.testing.assert_allclose(log.t_host, 0.002 * np.arange(51), rtol=0, atol=1e-9)
    assert (log.t_origin, log.t_host_origin) == (7 * 10**9, 10**18)
    assert log.metadata["arm"] == "servo3"
    assert json.loads(log.metadata["payload"]) == {"mass": 1.5}
    assert log.metadata["end_reason"] == "completed"
    assert [(event.level, event.name) for event in log.events] == [(20, "motion"), (40, "status")]
    assert log.events[0].t == pytest.approx(0.05)
    assert list(path.parent.iterdir()) == [path]


def test_one_write_for_a_sample(tmp_path):
    disk = CountingDisk()
    recorder = Recorder(tmp_path / "a.mcap", NAMES, disk=disk)
    before = disk.calls["write"]
    record(recorder, 20)
    assert disk.calls["write"] == before + 20
    recorder.close()


def next_before_the_end(records):
    try:
        return next(records)
    except (EndOfFile, struct.error):
        return None


def test_a_running_journal_is_an_mcap_stream_for_other_readers(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", NAMES)
    record(recorder, 30)
    messages = []
    with (tmp_path / "a.mcap").open("rb") as file:
        records = StreamReader(file).records
        while record_ := next_before_the_end(records):
            messages += [record_] if isinstance(record_, Message) else []
    assert sum(message.channel_id == 1 for message in messages) == 30
    recorder.close()


def test_an_end_that_was_not_requested_is_aborted(tmp_path):
    def fault():
        with Recorder(tmp_path / "a.mcap", NAMES) as recorder:
            record(recorder, 30)
            raise ZeroDivisionError("in the control loop")

    with pytest.raises(ZeroDivisionError):
        fault()
    with pytest.raises(BadLog, match=r"ended by a fault \(ZeroDivisionError"):
        read_log(tmp_path / "a.mcap")
    log = read_log(tmp_path / "a.mcap", accept_partial=True)
    assert (len(log), log.state) == (30, State.ABORTED)
    recorder = Recorder(tmp_path / "b.mcap", NAMES)
    record(recorder, 3)
    recorder.close("the operator stopped it")
    recorder.close()
    assert read_log(tmp_path / "b.mcap", accept_partial=True).state is State.ABORTED


def test_places_that_cannot_be_recorded_to(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(DeviceError, match="never overwritten"):
        Recorder(tmp_path / "a.mcap", NAMES)
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    with pytest.raises(DeviceError, match="not a folder"):
        Recorder(tmp_path / "a.mcap" / "b.mcap", NAMES)
    with pytest.raises(DeviceError, match="cannot be created"):
        Recorder(Path("/proc/a.mcap"), NAMES)


@pytest.mark.parametrize("t_device", [float("nan"), -1.0, float("inf"), 2.0**31])
def test_an_instant_that_no_stamp_can_hold_is_refused(tmp_path, t_device):
    with Recorder(tmp_path / "a.mcap", NAMES) as recorder:
        record(recorder, 2)
        with pytest.raises(DeviceError, match="cannot be recorded"):
            recorder.write(JointState(1.0, t_device, NAN, NAN, NAN, NAN, NAN), NAN, NAN, NAN)


def test_wrong_shapes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="different joint names"):
        Recorder(tmp_path / "a.mcap", ("a", "a"))
    with Recorder(tmp_path / "a.mcap", NAMES) as recorder:
        record(recorder, 2)
        with pytest.raises(ValueError, match="2 joints"):
            recorder.write(JointState(0.0, 0.0, *[np.zeros(2)] * 5), NAN, NAN, NAN)
        with pytest.raises(ValueError, match="shape"):
            recorder.write(sample(3), np.zeros(2), NAN, NAN)


def test_a_clock_that_no_stamp_holds_is_refused(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", NAMES, wall_clock=lambda: 2**31 * 10**9 - 10**9)
    recorder.write(sample(0))
    with pytest.raises(DeviceError, match=r"since 1970 cannot be recorded"):
        recorder.write(sample(1000))
    recorder.close("a clock that runs away")
    assert len(read_log(tmp_path / "a.mcap", accept_partial=True)) == 1
