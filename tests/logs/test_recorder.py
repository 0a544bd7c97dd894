"""A recording survives a kill, a full disk and a failing one, and says what state it is in."""

import errno
import json
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader

from logs import Recorder, State, read_log
from logs.boot import boot
from logs.journal import Disk
from logs.mcap_records import MAGIC, SEAL_TAG
from logs.recover import describe, recovered
from sim.errors import BadLog, DeviceError
from sim.joint_state import JointState, Status

NAMES = ("a", "bb", "a_long_joint_name")
NAN = np.full(3, np.nan)


def sample(k, status=Status.RUNNING):
    x = np.array([0.001 * k, -0.002 * k, 0.5])
    return JointState(
        t=50 + 0.002 * k, t_device=7 + 0.002 * k, q=x, dq=x + 1, tau=x + 2, current=x + 3, temperature=NAN, status=status
    )


def record(recorder, count, start=0):
    for k in range(start, start + count):
        recorder.write(sample(k), sample(k).q + 0.1, sample(k).dq + 0.1, NAN)


class CountingDisk(Disk):
    """The real disk, with the calls counted and one of them failing from call `fail_at` on."""

    def __init__(self, fail="", fail_at=10**9, number=errno.EIO):
        self.calls = {"write": 0, "sync": 0, "reserve": 0}
        self.fail, self.fail_at, self.number = fail, fail_at, number

    def _count(self, name):
        self.calls[name] += 1
        if name == self.fail and self.calls[name] >= self.fail_at:
            raise OSError(self.number, os.strerror(self.number))

    def write(self, fd, data):
        self._count("write")
        return super().write(fd, data)

    def sync(self, fd):
        self._count("sync")
        super().sync(fd)

    def reserve(self, fd, start, size):
        self._count("reserve")
        super().reserve(fd, start, size)


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


def test_an_open_file_is_refused_and_can_be_read_when_asked(tmp_path):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES)
    record(recorder, 30)
    with pytest.raises(BadLog, match="never ended"):
        read_log(path)
    log = read_log(path, accept_partial=True)
    assert (len(log), log.state) == (30, State.OPEN)
    assert any("never ended" in finding for finding in log.findings)
    recorder.close()
    assert read_log(path).state is State.CLEAN


@pytest.mark.parametrize("cut", [1, 8, 17, 18, 100, 400])
def test_a_journal_cut_in_a_sample_loses_that_sample(tmp_path, cut):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES)
    record(recorder, 30)
    data = path.read_bytes()
    recorder.close("test")
    path.write_bytes(data[:-cut])
    log = read_log(path)
    assert (len(log), log.state) == (29, State.KILLED)
    assert any("29 samples, at most 1 lost" in finding for finding in log.findings)


def test_a_damaged_sample_of_a_journal_ends_it(tmp_path):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES)
    record(recorder, 10)
    good = path.stat().st_size
    record(recorder, 10, start=10)
    data = bytearray(path.read_bytes())
    recorder.close("test")
    data[good + 120] ^= 1
    path.write_bytes(data)
    log = read_log(path, accept_partial=True)
    assert len(log) == 10
    assert any("check sum of the sample" in finding for finding in log.findings)


def test_an_end_that_was_not_asked_for_is_aborted(tmp_path):
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


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_no_success_after_a_failed_write(tmp_path, number):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES, disk=CountingDisk("write", 13, number))  # magic, head, ten samples
    record(recorder, 10)
    for k in range(10, 13):
        with pytest.raises(DeviceError, match="cannot be written"):
            recorder.write(sample(k), NAN, NAN, NAN)
    with pytest.raises(DeviceError, match="cannot be written"):
        recorder.close()
    assert not (tmp_path / "a.mcap.part").exists()
    with pytest.raises(BadLog):
        read_log(path)
    log = read_log(path, accept_partial=True)
    assert (len(log), log.state) == (10, State.ABORTED)
    assert "cannot be written" in log.metadata["end_reason"]


def test_a_short_write_is_a_failure_and_its_half_sample_is_cut_off(tmp_path):
    class ShortDisk(Disk):
        calls = 0

        def write(self, fd, data):
            self.calls += 1
            return super().write(fd, data[:40] if self.calls == 13 else data)

    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES, disk=ShortDisk())
    record(recorder, 10)
    whole = path.read_bytes()
    with pytest.raises(DeviceError, match="40 of"):
        recorder.write(sample(10), NAN, NAN, NAN)
    with pytest.raises(DeviceError):
        recorder.close()
    data = path.read_bytes()
    assert data.startswith(whole)
    assert data[len(whole) : len(whole) + 1] == b"\x0c"  # the note of the failure follows, a metadata record
    assert len(read_log(path, accept_partial=True)) == 10


def test_a_failing_sync_is_a_failure(tmp_path):
    recorder = Recorder(tmp_path / "a.mcap", NAMES, disk=CountingDisk("sync", 1))
    record(recorder, 10)
    with pytest.raises(DeviceError, match="cannot be written"):
        recorder.close()
    with pytest.raises(BadLog):
        read_log(tmp_path / "a.mcap")


def test_space_that_runs_low_stops_the_run_while_the_end_can_still_be_written(tmp_path):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES, disk=CountingDisk("reserve", 3, errno.ENOSPC), reserve=40_000)
    with pytest.raises(DeviceError, match="No space left"):
        record(recorder, 10_000)
    written = recorder.samples
    for k in range(written + 1, written + 11):  # the stop itself is still recorded, and every write goes on saying no
        with pytest.raises(DeviceError):
            recorder.write(sample(k), NAN, NAN, NAN)
    with pytest.raises(DeviceError):
        recorder.close()
    assert len(read_log(path, accept_partial=True)) == written + 11


def test_a_file_system_that_is_really_full(tmp_path):
    folder = tmp_path / "small"
    folder.mkdir()
    if (
        os.name != "posix"
        or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", folder], capture_output=True).returncode
    ):
        pytest.skip("a small file system cannot be mounted by this user")
    try:
        with pytest.raises(DeviceError, match="No space left"):
            Recorder(folder / "a.mcap", NAMES)
        assert list(folder.iterdir()) == []
        recorder = Recorder(folder / "a.mcap", NAMES, reserve=32_768)
        with pytest.raises(DeviceError, match="No space left"):
            record(recorder, 10_000)
        with pytest.raises(DeviceError):
            recorder.close()
        log = read_log(folder / "a.mcap", accept_partial=True)
        assert len(log) == recorder.samples + 1  # the sample that told of the end is on the disk too
        assert len(log) > 100
    finally:
        subprocess.run(["umount", folder], check=True)


def test_places_that_cannot_be_recorded_to(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(DeviceError, match="never overwritten"):
        Recorder(tmp_path / "a.mcap", NAMES)
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    with pytest.raises(DeviceError, match="no folder"):
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


VICTIM = """
import mmap, struct, sys, numpy as np
from logs import Recorder
from sim.joint_state import JointState
file = open(sys.argv[2], "r+b")
board = mmap.mmap(file.fileno(), 8)
recorder = Recorder(sys.argv[1], ("a", "b", "c"))
nan = np.full(3, np.nan)
k = 0
while True:
    x = np.array([0.001 * k, 0.0, 1.0])
    recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, nan), x, x, nan)
    k += 1
    struct.pack_into("<q", board, 0, k)
"""


def killed_recording(folder, delay):
    """Samples that the killed program knew to be written, and the log that is left."""
    board, path = folder / "board", folder / "a.mcap"
    board.write_bytes(bytes(8))
    path.unlink(missing_ok=True)
    victim = subprocess.Popen([sys.executable, "-c", VICTIM, str(path), str(board)])
    try:
        with board.open("rb") as file, mmap.mmap(file.fileno(), 8, prot=mmap.PROT_READ) as view:
            deadline = time.monotonic() + 60
            while not struct.unpack_from("<q", view)[0] and victim.poll() is None and time.monotonic() < deadline:
                time.sleep(0.005)
            time.sleep(delay)
            victim.send_signal(signal.SIGKILL)
            victim.wait()
            known = struct.unpack_from("<q", view)[0]
    finally:
        victim.kill()
        victim.wait()
    return known, read_log(path, accept_partial=True)


@pytest.mark.parametrize("kills", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_loses_at_most_one_sample(tmp_path, kills):
    rng = random.Random(5)
    for _ in range(kills):
        known, log = killed_recording(tmp_path, rng.uniform(0.0, 0.05))
        assert known > 0
        assert known <= len(log) <= known + 1
        np.testing.assert_allclose(log.q[:, 0], 0.001 * np.arange(len(log)))


def killed(path, change=lambda data: data):
    """The journal of a recorder that is gone, without its lock."""
    recorder = Recorder(path, NAMES)
    record(recorder, 30)
    data = change(path.read_bytes())
    recorder.close()
    path.write_bytes(data)
    return data


def test_a_recording_of_another_computer_is_left_alone_while_it_may_be_written(tmp_path):
    path = tmp_path / "a.mcap"
    data = killed(path, lambda data: data.replace(boot().encode(), b"0" * len(boot())))
    path.write_bytes(data := resealed(data))
    log = read_log(path)
    assert (len(log), log.state) == (30, State.KILLED)
    assert path.read_bytes() == data
    long_ago = path.stat().st_mtime - 100
    os.utime(path, (long_ago, long_ago))
    assert recovered(path).endswith("30 samples, at most 1 lost")
    assert path.read_bytes() != data
    assert read_log(path).metadata["end_reason"].endswith("30 samples, at most 1 lost")


def resealed(data):
    """The journal with the check sum of its head made anew."""
    end = data.index(SEAL_TAG)
    head = data[len(MAGIC) : end - 9]
    return data[: end + 4] + zlib.crc32(head).to_bytes(4, "little") + data[end + 8 :]


def test_a_killed_recording_is_ended_once_and_one_that_goes_on_is_left_alone(tmp_path):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, NAMES)
    record(recorder, 30)
    before = path.read_bytes()
    assert recovered(path) is None
    with pytest.raises(BadLog, match=r"still being written.*wait until it has ended"):
        read_log(path)
    assert path.read_bytes() == before
    recorder.close()
    killed(tmp_path / "b.mcap")
    first = recovered(tmp_path / "b.mcap")
    assert first.endswith("30 samples, at most 1 lost")
    assert recovered(tmp_path / "b.mcap") is None
    assert describe(tmp_path / "b.mcap") == first
    assert {file.name for file in tmp_path.iterdir()} == {"a.mcap", "b.mcap"}


def test_a_damaged_journal_of_a_killed_program_stays_as_it_is(tmp_path):
    path = tmp_path / "a.mcap"
    data = bytearray(killed(path))
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert recovered(path) is None
    with pytest.raises(BadLog, match="check sum of the sample"):
        read_log(path)
    assert path.read_bytes() == data
    assert 0 < len(read_log(path, accept_partial=True)) < 30
