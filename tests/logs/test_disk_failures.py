"""A full or failing disk ends a recording as aborted: what was written stays readable, and no success is reported."""

import errno
import os
import subprocess

import pytest

from logs import Recorder, State, read_log
from logs.journal import Disk
from sim.errors import BadLog, DeviceError
from tests.logs.written import NAMES, NAN, CountingDisk, record, sample


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
    assert data[len(whole) : len(whole) + 1] == b"\x0c"  # then a metadata record that notes the failure
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
    for k in range(written + 1, written + 11):  # samples of the stop are still recorded, but every write fails
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
        assert len(log) == recorder.samples + 1  # the sample whose write failed is on disk too
        assert len(log) > 100
    finally:
        subprocess.run(["umount", folder], check=True)
