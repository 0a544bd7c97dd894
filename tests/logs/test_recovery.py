"""An unfinished recording is read up to its last complete sample, and is finished once after its program has gone."""

import os
import zlib

import pytest

from logs import Recorder, State, read_log
from logs.boot import boot
from logs.mcap_records import MAGIC, SEAL_TAG
from logs.recover import describe, recovered
from sim.errors import BadLog
from tests.logs.written import NAMES, killed, record


def test_an_open_file_is_refused_and_can_be_read_when_requested(tmp_path):
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
    assert any("checksum of the sample" in finding for finding in log.findings)


def resealed(data):
    """The journal with the checksum of its head recomputed."""
    end = data.index(SEAL_TAG)
    head = data[len(MAGIC) : end - 9]
    return data[: end + 4] + zlib.crc32(head).to_bytes(4, "little") + data[end + 8 :]


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
    with pytest.raises(BadLog, match="checksum of the sample"):
        read_log(path)
    assert path.read_bytes() == data
    assert 0 < len(read_log(path, accept_partial=True)) < 30
