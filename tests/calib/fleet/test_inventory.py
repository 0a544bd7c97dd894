"""Which recordings exist, and which arm each states that it belongs to."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from calib.fleet.inventory import by_arm, foreign, inventory
from logs import Recorder
from logs.prediction import write_prediction
from sim.arm import Arm
from sim.errors import ConfigError
from sim.joint_state import JointState
from tests.calib.fleet.conftest import write_recording


def test_recordings_are_found_by_what_they_say(plant: Path) -> None:
    recordings, unknown = inventory(str(plant))
    arms = by_arm(recordings)
    assert list(arms) == [
        "nobodys+unknown+S-unknown", "ur5e+bad+S-bad", *[f"ur5e+cell-{k}+S-cell-{k}" for k in range(5)], "ur5e+still+S-still",
    ]  # fmt: skip
    assert [r.motion for r in arms["ur5e+cell-2+S-cell-2"]] == ["excitation", "validation"]
    assert {r.started for r in recordings} == {"2026-01-01T00:00:00+00:00"}
    assert [Path(address).name for address, _ in unknown] == ["junk.mcap"]


def test_a_recording_that_was_never_finished_still_says_whose_it_is(tmp_path: Path) -> None:
    nan = np.full(1, np.nan)
    recorder = Recorder(tmp_path / "cut.mcap", ["a"], {"arm": "one"}, reserve=1 << 16)
    for k in range(50):
        recorder.write(JointState(k * 0.01, k * 0.01, np.zeros(1), nan, nan, nan, nan))
    recordings, unknown = inventory(str(tmp_path))
    recorder.close()
    assert [r.arm for r in recordings] == ["one"]
    assert unknown == []


def test_what_is_no_file_is_listed_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    recordings, unknown = inventory(str(tmp_path))
    assert recordings == []
    assert ["not a regular file" in why for _, why in unknown] == [True]


def test_a_recording_that_was_cut_short_still_says_whose_it_is(tmp_path: Path, ur5e: Arm) -> None:
    write_recording(tmp_path / "cell" / "a.mcap", ur5e, ur5e, 1, seconds=2.0)
    nan = np.full(1, np.nan)
    with Recorder(tmp_path / "cell" / "b.mcap", ["a"], {"arm": "one"}) as recorder:
        for k in range(5000):
            recorder.write(JointState(k * 0.01, k * 0.01, np.array([np.sin(k)]), nan, nan, nan, nan))
    for file in sorted((tmp_path / "cell").iterdir()):
        data = file.read_bytes()
        file.write_bytes(data[: 2 * len(data) // 3])
    recordings, unknown = inventory(str(tmp_path))
    assert [r.arm for r in recordings] == ["ur5e", "one"]
    assert unknown == []


@pytest.mark.parametrize("address", ["nowhere", "nothing://there"])
def test_a_folder_that_is_not_there_is_named(address: str) -> None:
    with pytest.raises(ConfigError, match=address):
        inventory(address)


def test_recordings_of_another_form_are_named(tmp_path: Path) -> None:
    for name in ("a.csv", "notes.txt", "b.mcap"):
        (tmp_path / name).write_text("")
    assert foreign(str(tmp_path)) == [str(tmp_path / "a.csv")]


def test_predictions_beside_recordings_are_not_recordings(tmp_path: Path, ur5e: Arm) -> None:
    write_recording(tmp_path / "cell" / "a.mcap", ur5e, ur5e, 3, seconds=2.0)
    stamps, x = 10**18 + np.arange(9) * 8_000_000, np.zeros((9, ur5e.n))
    write_prediction(tmp_path / "cell" / "prediction.mcap", stamps, ur5e.joint_names, x, x, x, x, "", (), np.zeros((9, 0, 7)))
    recordings, unknown = inventory(str(tmp_path))
    assert [Path(r.address).name for r in recordings] == ["a.mcap"]
    assert not unknown
    (tmp_path / "cell" / "a.mcap").unlink()
    with pytest.raises(ConfigError, match="holds no recording"):
        inventory(str(tmp_path))
