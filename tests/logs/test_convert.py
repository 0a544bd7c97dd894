"""Importing and recovering: readings that survive are bit-identical, and losses are reported."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from logs import Recorder, State, read_log
from logs.convert import import_recording, write_log
from sim.errors import BadLog, DeviceError
from sim.joint_state import JointState

NAMES = ("t", "t_host", "q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")


def same(a, b):
    assert a.joint_names == b.joint_names
    assert (a.t_origin, a.events) == (b.t_origin, b.events)
    for name in NAMES:
        np.testing.assert_allclose(
            getattr(a, name), getattr(b, name), rtol=0, atol=0 if name[0] != "t" else 1e-12, err_msg=name
        )


def test_a_csv_file_becomes_a_clean_log(tmp_path, csv_text):
    source = tmp_path / "a.csv"
    source.write_text(csv_text())
    done = import_recording(source, tmp_path / "out" / "a.mcap")
    same(read_log(source), done.log)
    assert (done.log.state, done.ended, done.left_out) == (State.CLEAN, State.UNSTATED, ())
    assert np.isnan(done.log.t_host).all()
    assert done.log.metadata["imported_from"] == "a.csv"
    assert read_log(done.path).state is State.CLEAN
    with pytest.raises(DeviceError, match="never overwritten"):
        import_recording(source, done.path)


def test_commanded_speeds_alone_are_kept(tmp_path, csv_text):
    (tmp_path / "a.csv").write_text(csv_text())
    log = read_log(tmp_path / "a.csv")
    speeds = np.arange(log.q.size, dtype=float).reshape(log.q.shape)
    nothing = np.full(log.q.shape, np.nan)
    target = tmp_path / "a.mcap"
    write_log(replace(log, q_cmd=nothing, dq_cmd=speeds, tau_cmd=nothing), target, "clean", {})
    np.testing.assert_array_equal(read_log(target).dq_cmd, speeds)


def test_damaged_rows_leave_an_aborted_log_that_says_so(tmp_path, csv_text):
    lines = csv_text().splitlines()
    lines[9] = lines[9].replace("0.", "nan", 1)
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    done = import_recording(tmp_path / "a.csv", tmp_path / "a.mcap")
    assert (len(done.log), done.log.state, done.ended) == (49, State.ABORTED, State.CUT)
    assert any("row 10" in sentence for sentence in done.left_out)
    assert json.loads(done.log.metadata["findings"]) == list(done.left_out)
    with pytest.raises(BadLog, match="ended by a fault"):
        read_log(done.path)


def test_an_import_writes_down_the_arm_where_the_recording_does_not(tmp_path, csv_text):
    (tmp_path / "a.csv").write_text(csv_text())
    done = import_recording(tmp_path / "a.csv", tmp_path / "a.mcap", arm={"arm": "one", "arm_sha256": "1"})
    assert (done.log.metadata["arm"], done.log.metadata["arm_sha256"]) == ("one", "1")
    again = import_recording(tmp_path / "a.mcap", tmp_path / "b.mcap", arm={"arm": "two", "arm_sha256": "2"})
    assert (again.log.metadata["arm"], again.log.metadata["arm_sha256"]) == ("one", "1")


def test_samples_of_one_instant_are_imported_once(tmp_path, csv_text):
    cells = [line.split(",") for line in csv_text().splitlines()]
    cells[20][0] = cells[19][0]
    (tmp_path / "a.csv").write_text("\n".join(map(",".join, cells)) + "\n")
    done = import_recording(tmp_path / "a.csv", tmp_path / "a.mcap")
    assert len(done.log) == 49
    assert sum("1 sample carries the stamp" in sentence for sentence in (*done.left_out, *done.sampling.findings)) == 2
    assert any("is left out" in sentence for sentence in done.sampling.findings)
    assert done.sampling.missing == 0


def test_a_foreign_mcap_file_and_a_bag_folder(tmp_path, mcap_bytes):
    (tmp_path / "a.mcap").write_bytes(mcap_bytes())
    done = import_recording(tmp_path / "a.mcap", tmp_path / "b.mcap")
    same(read_log(tmp_path / "a.mcap"), done.log)
    bag = tmp_path / "bag"
    bag.mkdir()
    for k in range(2):
        keep = slice(0, 200) if k == 0 else slice(200, 400)
        (bag / f"bag_{k}.mcap").write_bytes(mcap_bytes(lambda j, m, keep=keep: m if keep.start <= j < keep.stop else None))
    with pytest.raises(BadLog, match=r"2 MCAP files and no metadata.yaml"):
        read_log(bag)
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    np.testing.assert_array_equal(read_log(bag).q, done.log.q)
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadLog, match=r"no \.mcap file"):
        read_log(tmp_path / "empty")


@pytest.mark.parametrize("cut", [0, 50])
def test_an_open_journal_is_recovered_message_by_message(tmp_path, cut):
    path = tmp_path / "a.mcap"
    recorder = Recorder(path, ("a", "b"), {"arm": "x"})
    for k in range(100):
        x = np.array([0.001 * k, 1.0])
        recorder.write(JointState(5 + 0.002 * k, 0.002 * k, x, x, x, x, x), x, x, x)
    recorder.event(20, "motion", "starts", 0.1)
    data = path.read_bytes()
    recorder.close("test")
    path.unlink()
    path.write_bytes(data[: len(data) - cut])
    done = import_recording(path, tmp_path / "out.mcap")
    same(read_log(path, accept_partial=True), done.log)
    assert (len(done.log), done.ended, done.log.state) == (100, State.KILLED, State.KILLED)
    assert len(done.log.events) == (0 if cut else 1)
    assert done.log.metadata["arm"] == "x"
    assert re.fullmatch(r"killed at \d\d:\d\d:\d\d UTC, 100 samples, at most 1 lost", done.log.metadata["end_reason"])
    assert done.log.metadata["end_reason"] in done.left_out
    assert path.exists()


def test_a_recording_that_lost_a_chunk_says_how_many_samples(tmp_path):
    path = tmp_path / "a.mcap"
    with Recorder(path, ("a", "b")) as recorder:
        for k in range(5000):
            x = np.array([0.0001 * k, 1.0])
            recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x), x, x, x)
    data = bytearray(path.read_bytes())
    data[3000] ^= 1
    path.write_bytes(data)
    with pytest.raises(BadLog, match="chunk at byte"):
        read_log(path)
    log = read_log(path, accept_partial=True)
    assert 0 < len(log) < 5000
    assert any(f"says 5000 samples, {len(log)} survive" in finding for finding in log.findings)


@pytest.mark.parametrize("since", [3e9, 2**31])
def test_instants_that_no_stamp_holds_are_refused_and_nothing_is_left(tmp_path, csv_text, since):
    head, *rows = csv_text().splitlines()
    source = tmp_path / "a.csv"
    source.write_text("\n".join([head, *[f"{float(r.split(',', 1)[0]) + since!r},{r.split(',', 1)[1]}" for r in rows]]) + "\n")
    with pytest.raises(BadLog, match=r"since 1970 cannot be written"):
        import_recording(source, tmp_path / "out.mcap")
    assert sorted(x.name for x in tmp_path.iterdir()) == ["a.csv"]
