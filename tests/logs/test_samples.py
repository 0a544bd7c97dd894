"""The recordings shipped with the project are readable and hold what is expected."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from logs import State, read_log
from logs.convert import import_recording
from sim.arm import load_arm
from sim.prediction import predict
from sim.trajectory import Trajectory

FOLDER = Path(__file__).resolve().parent.parent.parent / "logs" / "samples"


def test_they_are_small():
    files = [path for path in FOLDER.iterdir() if path.suffix in (".mcap", ".csv")]
    assert len(files) == 3
    assert all(path.stat().st_size < 300_000 for path in files)


def test_the_finished_recording_holds_the_torque_of_its_arm():
    arm = load_arm("servo6")
    log = read_log(FOLDER / "servo6_excitation.mcap", arm.joint_names)
    assert (len(log), log.state, log.findings) == (801, State.CLEAN, ())
    assert log.metadata["arm"] == "servo6"
    assert [event.message for event in log.events] == ["excitation starts"]
    assert log.clock.skew == pytest.approx(40e-6, abs=5e-6)
    smooth = np.array([np.convolve(x, np.ones(9) / 9, mode="same") for x in log.q.T]).T
    dq = np.gradient(smooth, log.t, axis=0)
    motion = Trajectory(log.t, log.q, dq, np.gradient(dq, log.t, axis=0))
    inside = slice(20, -20)
    residual = (log.tau - predict(arm, motion))[inside]
    assert np.all(residual[:, :3].std(axis=0) < 0.35 * log.tau[inside, :3].std(axis=0))


def test_the_killed_recording_is_recovered(tmp_path):
    shutil.copy(FOLDER / "servo6_killed.mcap", tmp_path)
    done = import_recording(tmp_path / "servo6_killed.mcap", tmp_path / "a.mcap")
    assert (len(done.log), done.log.state) == (119, State.KILLED)
    assert any("119 samples, at most 1 lost" in sentence for sentence in done.left_out)
    assert len(read_log(tmp_path / "servo6_killed.mcap")) == 119
    whole = read_log(FOLDER / "servo6_excitation.mcap")
    np.testing.assert_array_equal(done.log.q, whole.q[:119])


def test_the_csv_file_is_read_for_its_arm():
    arm = load_arm("ur10e")
    log = read_log(FOLDER / "ur10e_ur_rtde.csv", arm.joint_names)
    assert len(log) == 601
    assert np.isnan(log.tau).all()
    assert np.abs(log.current).max() > 1
