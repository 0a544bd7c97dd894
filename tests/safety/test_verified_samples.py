"""The verified motions of a stage: every sample is available, and motions that an arm could not follow are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from safety.clear import ClearedTrajectory
from safety.monitor_link import tube_file
from safety.verified_samples import VerifiedSamples
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from tests.safety.conftest import RATE


def test_a_tube_has_every_sample_of_every_motion_and_no_other(motions: list[ClearedTrajectory], tube: VerifiedSamples) -> None:
    for leg, motion in enumerate(motions):
        for k in (0, 17, len(motion) - 1):
            found = tube.sample(leg, k)
            assert found is not None
            q, expected = found
            np.testing.assert_array_equal(q, motion.q[k])
            np.testing.assert_array_equal(expected.tau_hat, motion.tau_hat[k])
            np.testing.assert_array_equal(expected.doubt, motion.doubt[k])
            np.testing.assert_array_equal(expected.sudden, motion.sudden[k])
            np.testing.assert_array_equal(expected.load, motion.load[k])
            assert expected.room == motion.room[k]
        assert tube.sample(leg, len(motion)) is None
        np.testing.assert_array_equal(tube.last(leg)[0], motion.q[-1])
    for leg, k in ((0, -1), (-1, 0), (2, 0)):
        assert tube.sample(leg, k) is None
    assert tube.last(-1) == tube.last(2) == []


def test_nobody_else_can_open_the_file_of_a_tube(
    motions: list[ClearedTrajectory], arm: Arm, cell: Cell, tmp_path: Path
) -> None:
    file = tube_file(tmp_path, motions)
    VerifiedSamples(file, [len(m) for m in motions], arm, cell, RATE)
    assert not file.exists()


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (0, np.nan, "finite"),
        (20, np.inf, "finite"),
        (2, 9.0, "range"),
        (2, -9.0, "range"),
        (30, 1e-6, "room"),
        (3, -1.0, "speed"),
    ],
)
def test_a_tube_that_is_not_fit_to_be_driven_is_refused(
    motions: list[ClearedTrajectory], arm: Arm, cell: Cell, tmp_path: Path, column: int, value: float, message: str
) -> None:
    file = tube_file(tmp_path, motions)
    rows = np.load(file, mmap_mode="r+")
    rows[100, column] = value
    rows.flush()
    with pytest.raises(SafetyStop, match=message):
        VerifiedSamples(file, [len(m) for m in motions], arm, cell, RATE)


def test_a_tube_of_another_length_is_refused(motions: list[ClearedTrajectory], arm: Arm, cell: Cell, tmp_path: Path) -> None:
    with pytest.raises(SafetyStop, match="verified samples"):
        VerifiedSamples(tube_file(tmp_path, motions), [len(motions[0])], arm, cell, RATE)


def test_a_jump_from_one_motion_to_the_next_is_no_speed(
    motions: list[ClearedTrajectory], arm: Arm, cell: Cell, tmp_path: Path
) -> None:
    middle = [len(motions[0]) // 3, len(motions[0]) - len(motions[0]) // 3]
    file = tube_file(tmp_path, motions[:1])
    rows = np.load(file, mmap_mode="r+")
    rows[middle[0] :, 0] += 0.3
    rows.flush()
    VerifiedSamples(file, middle, arm, cell, RATE)


@pytest.mark.parametrize("off", [-9.0, 9.0])
def test_a_motion_beside_the_range_of_one_joint_is_refused(
    motions: list[ClearedTrajectory], arm: Arm, cell: Cell, tmp_path: Path, off: float
) -> None:
    file = tube_file(tmp_path, motions)
    rows = np.load(file, mmap_mode="r+")
    rows[:, 2] += off
    rows.flush()
    with pytest.raises(SafetyStop, match="range"):
        VerifiedSamples(file, [len(m) for m in motions], arm, cell, RATE)
