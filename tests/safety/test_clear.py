"""`clear` is the only way to a ClearedTrajectory, and refuses what any single check refuses."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.driver import DeviceStop
from safety.clear import ClearedTrajectory, clear, require_cleared
from sim.arm import Arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError, SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import CELL, HOME, sine


def test_a_cleared_motion_is_the_samples_that_will_be_sent(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    cleared = clear(motion, arm, cell, rate=125)
    assert len(cleared) == 501
    np.testing.assert_allclose(np.diff(cleared.t), 1 / 125)
    np.testing.assert_array_equal(cleared.q[-1], motion.q[-1])
    assert set(cleared.verdict.used) == {"q", "dq", "ddq", "jerk", "point speed", "tau", "rms torque", "power"}
    assert all(0 < share <= 1 for share in cleared.verdict.used.values())
    assert set(cleared.verdict.near) == {"the cell", "itself"}
    assert 0.01 <= cleared.verdict.room <= 0.1
    assert cleared.verdict.braking == cleared.verdict.device_braking == 1.0
    assert require_cleared(cleared, arm, 125.0) is cleared


def test_a_motion_that_does_not_end_on_a_period_is_sent_to_its_end(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    cleared = clear(motion.scaled(0.9991), arm, cell, rate=100)
    assert cleared.t[-1] >= 4 / 0.9991 > cleared.t[-2]
    np.testing.assert_array_equal(cleared.q[-1], motion.q[-1])


def test_nothing_else_makes_or_changes_one(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    cleared = clear(motion, arm, cell)
    with pytest.raises(TypeError, match="clear the motion"):
        ClearedTrajectory(None, {})
    for steal in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError):
            steal(cleared)
    with pytest.raises(AttributeError, match="cannot be changed"):
        cleared.q = cleared.q + 1
    with pytest.raises(AttributeError):
        _ = cleared.nonsense
    for name in ("t", "q", "dq", "ddq", "tau_hat", "doubt", "room", "braking"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(cleared, name)[0] = 9.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            getattr(cleared, name).flags.writeable = True


def test_what_was_not_cleared_for_this_arm_and_rate_is_not_sent(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    cleared = clear(motion, arm, cell)
    forged = object.__new__(ClearedTrajectory)
    object.__setattr__(forged, "_values", cleared._values)
    for thing in (motion, forged, None, cleared.q):
        with pytest.raises(SafetyStop, match="nothing else is ever sent"):
            require_cleared(thing, arm, 500.0)
    with pytest.raises(SafetyStop, match="another arm"):
        require_cleared(cleared, replace(arm, sha256="0" * 64), 500.0)
    with pytest.raises(SafetyStop, match="500 Hz"):
        require_cleared(cleared, arm, 125.0)


@pytest.mark.parametrize("rate", [0, -1, 9.99, 2001, np.nan, np.inf, "500", True * 1j])
def test_a_rate_that_is_none_is_refused(arm: Arm, cell: Cell, motion: Trajectory, rate: object) -> None:
    with pytest.raises(SafetyStop, match="rate"):
        clear(motion, arm, cell, rate=rate)  # type: ignore[arg-type]


@pytest.mark.parametrize("thing", [None, 3, np.zeros((4, 6)), "motion"])
def test_only_a_trajectory_can_be_cleared(arm: Arm, cell: Cell, thing: object) -> None:
    with pytest.raises(SafetyStop, match="not a Trajectory"):
        clear(thing, arm, cell)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("limit", "value", "message"),
    [
        ("q_max", HOME + 0.01, "q "),
        ("dq_max", np.full(6, 0.1), "dq"),
        ("ddq_max", np.full(6, 0.1), "ddq"),
        ("jerk_max", np.full(6, 0.1), "jerk"),
        ("tau_max", np.full(6, 5.0), "torque"),
    ],
)
def test_each_limit_of_the_arm_is_checked(
    arm: Arm, cell: Cell, motion: Trajectory, limit: str, value: np.ndarray, message: str
) -> None:
    with pytest.raises(SafetyStop, match=message):
        clear(motion, replace(arm, **{limit: value}), cell)  # type: ignore[arg-type]


def cell_of(tmp_path: Path, text: str) -> Cell:
    file = tmp_path / "cell.toml"
    file.write_text(text)
    return load_cell(file)


def test_the_cell_rules_are_checked(arm: Arm, tmp_path: Path, motion: Trajectory) -> None:
    head, tail = CELL.split("[[obstacles]]", 1)
    rules = {"point_speed_max = 0.05": "point of it may move", "clearance_obstacle = 0.9": "nearer than the margin"}
    for rule, message in rules.items():
        with pytest.raises(SafetyStop, match=message):
            clear(motion, arm, cell_of(tmp_path, f"{head}[motion]\n{rule}\n[[obstacles]]{tail}"))
    heavy = cell_of(tmp_path, f"{head}[payload]\nmass = 40.0\ncom = [0, 0, 0.3]\n[[obstacles]]{tail}")
    with pytest.raises(SafetyStop, match="torque"):
        clear(motion, arm, heavy)


def test_the_power_of_all_joints_together_is_limited(arm: Arm, cell: Cell) -> None:
    strong = replace(arm, tau_max=np.full(6, 1e4), dq_max=np.full(6, 50.0), ddq_max=np.full(6, 2e3), jerk_max=np.full(6, 1e6))
    with pytest.raises(SafetyStop, match="power"):
        clear(sine(amplitude=0.25, duration=0.4), strong, cell_free(cell))


def cell_free(cell: Cell) -> Cell:
    free = cell.table.motion.model_copy(update={"point_speed_max": 100.0})
    return replace(cell, table=cell.table.model_copy(update={"motion": free, "obstacles": []}))


@pytest.mark.parametrize(("deceleration", "allowed"), [(20.0, True), (0.2, False)])
def test_a_device_that_brakes_slowly_needs_more_room(
    arm: Arm, tmp_path: Path, motion: Trajectory, deceleration: float, allowed: bool
) -> None:
    limit = motion.q.max(axis=0) + 0.03
    tight, free = replace(arm, q_max=limit), cell_of(tmp_path, CELL)
    stop = DeviceStop(reaction=0.0, deceleration=deceleration)
    if allowed:
        assert clear(motion, tight, free, stop=stop).verdict.stop_angle > 0
    else:
        with pytest.raises(SafetyStop, match="the device's own stop"):
            clear(motion, tight, free, stop=stop)


def test_a_slow_computer_needs_more_room_and_an_unmeasured_one_is_refused(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    stop = DeviceStop(reaction=0.02, deceleration=4.0, proportional=True)
    near = clear(motion, arm, cell, stop=stop).verdict.stop_angle
    assert clear(motion, arm, cell, stop=stop, latency=0.1).verdict.stop_angle > near
    for latency in (np.nan, np.inf, -0.01):
        with pytest.raises(SafetyStop, match="latency"):
            clear(motion, arm, cell, stop=stop, latency=latency)


@pytest.mark.parametrize(
    "values", [(np.nan, 4.0), (0.1, np.nan), (-0.1, 4.0), (0.1, 0.0), (0.1, -4.0), (np.inf, 4.0), (0.1, np.inf)]
)
def test_a_device_stop_that_says_nothing_is_refused(values: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="reaction"):
        DeviceStop(*values)


def test_a_device_stop_in_other_words_is_refused(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    with pytest.raises(SafetyStop, match="'at once' is not a DeviceStop"):
        clear(motion, arm, cell, stop="at once")  # type: ignore[arg-type]
