"""Moving each joint by two degrees and back checks joint order and torque sign; another joint that moves is found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from drivers import open_driver
from drivers.mock import MockDriver
from safety.joint_test import ANGLE, compare, try_joints
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import SafetyStop
from sim.joint_state import JointState

JOINT = 2


@pytest.fixture(scope="module")
def ur10e() -> Arm:
    return load_arm("ur10e")


@pytest.fixture(scope="module")
def mock_cell() -> Cell:
    shipped = load_cell("mock-ur10e")
    return replace(shipped, table=shipped.table.model_copy(update={"options": {"rate": 100.0}}))


@pytest.fixture
def driver(ur10e: Arm, mock_cell: Cell) -> MockDriver:
    made = open_driver(mock_cell, ur10e)
    assert isinstance(made, MockDriver)
    return made


def test_a_healthy_arm_passes_and_ends_where_it_began(driver: MockDriver, mock_cell: Cell, ur10e: Arm) -> None:
    shown: list[str] = []
    with driver:
        begin = driver.read().q
        checks = try_joints(driver, mock_cell, show=shown.append)
        assert driver.read().q == pytest.approx(begin, abs=5e-3)
    assert [c.name for c in checks] == [*(f"move {name}" for name in ur10e.joint_names), "gravity torque"]
    assert [c.detail for c in checks if not c.ok] == []
    assert all("in the direction of motion" in c.detail for c in checks[:-1])
    assert shown == [
        *(f"{name} by +2 deg" for name in ur10e.joint_names),
        "3 slow lines there and back, for the gravity torque",
    ]


def test_a_torque_of_the_wrong_sign_is_found(driver: MockDriver, mock_cell: Cell) -> None:
    driver.faults.append(lambda state: replace(state, tau=state.tau * [-1, 1, 1, 1, 1, 1], current=state.current * np.nan))
    with driver:
        checks = try_joints(driver, mock_cell)
    assert [c.ok for c in checks] == [False, True, True, True, True, True]
    assert "sign" in checks[0].remedy


def test_an_arm_without_brakes_must_stand_at_its_rest(driver: MockDriver, mock_cell: Cell) -> None:
    away = np.add(mock_cell.table.home, [0, 0, 0.2, 0, 0, 0])
    cell = replace(mock_cell, table=mock_cell.table.model_copy(update={"rest": away.tolist()}))
    with driver, pytest.raises(SafetyStop, match=r"elbow_joint stands 0.200 rad away from the rest pose"):
        try_joints(driver, cell)


def test_an_arm_without_brakes_may_be_tried_at_its_rest(driver: MockDriver, mock_cell: Cell) -> None:
    cell = replace(mock_cell, table=mock_cell.table.model_copy(update={"rest": mock_cell.table.home}))
    with driver:
        *moved, gravity = try_joints(driver, cell)
    assert all(check.ok for check in moved)
    assert (gravity.ok, "stays at its rest pose" in gravity.detail) == (None, True)


def test_a_joint_that_can_turn_neither_way_is_refused(mock_cell: Cell, ur10e: Arm) -> None:
    home = np.array(mock_cell.table.home)
    narrow = replace(ur10e, q_min=home - 0.6 * ANGLE, q_max=home + 0.6 * ANGLE)
    made = open_driver(mock_cell, narrow)
    with made, pytest.raises(SafetyStop, match=r"shoulder_pan_joint cannot turn by two degrees either way: .* leaves"):
        try_joints(made, mock_cell)


def way(begin: np.ndarray, turned: np.ndarray, dq: float, tau: np.ndarray, current: bool = False) -> list[JointState]:
    nothing, states = np.full(6, np.nan), []
    for k, x in enumerate(np.linspace(0, 1, 200)):
        speed = np.zeros(6)
        speed[JOINT] = dq * math.sin(math.pi * x)
        load = tau + 0.1 * np.random.default_rng(k).normal(size=6)
        channels = (nothing, load) if current else (load, nothing)
        states.append(JointState(0.002 * k, 0.002 * k, begin + turned * x, speed, *channels, nothing))
    return states


def turned(angle: float, joint: int = JOINT) -> np.ndarray:
    q = np.zeros(6)
    q[joint] = angle
    return q


@pytest.mark.parametrize(
    ("moved", "friction", "current", "ok", "word"),
    [
        (turned(ANGLE), 5.0, False, True, "5 N m in the direction"),
        (turned(ANGLE), 5.0, True, True, "5 A in the direction"),
        (turned(ANGLE), -5.0, False, False, "-5 N m in the direction"),
        (turned(ANGLE), 0.0, False, True, "too little to tell"),
        (turned(ANGLE), math.nan, False, True, "no torque"),
        (turned(-ANGLE), 5.0, False, False, "turned -2.00 deg for +2.00 deg"),
        (turned(ANGLE, 3), 5.0, False, False, "wrist_1_joint most of all"),
        (turned(ANGLE) + turned(ANGLE, 4), 5.0, False, False, "others at most 2.00 deg"),
        (turned(0.4 * ANGLE), 5.0, False, False, "turned +0.80 deg"),
        (turned(math.nan), 5.0, False, False, "turned +nan deg"),
    ],
)
def test_what_readings_say(ur10e: Arm, moved: np.ndarray, friction: float, current: bool, ok: bool, word: str) -> None:
    gravity, against = np.full(6, 30.0), np.zeros(6)
    against[JOINT] = friction
    there = way(np.zeros(6), moved, 0.06, gravity + against, current)
    back = way(moved, -moved, -0.06, gravity - against, current)
    check = compare(ur10e, JOINT, ANGLE, there, back)
    assert (check.ok, word in check.detail) == (ok, True), check
    assert check.ok or check.remedy


@pytest.mark.parametrize(
    ("lost_torques", "lost_speeds", "found"),
    [
        ([0], [], "5 N m in the direction"),
        ([60, 61, 120], [], "5 N m in the direction"),
        ([], [60], "5 N m in the direction"),
        (range(200), [], "3 A in the direction"),
        (range(3, 200), [], "3 A in the direction"),
    ],
)
def test_torque_is_never_compared_with_current(
    ur10e: Arm, lost_torques: Sequence[int], lost_speeds: Sequence[int], found: str
) -> None:
    """A good arm that reports torque and current.

    Samples that are lost on one way are left out. If one way has too few torques, current is compared on both.
    """
    moved, offset, against = turned(ANGLE), np.full(6, 30.0), np.full(6, 5.0)
    there, back = way(np.zeros(6), moved, 0.06, offset + against), way(moved, -moved, -0.06, offset - against)
    there = [replace(state, current=state.tau * 0.6) for state in there]
    back = [replace(state, current=state.tau * 0.6) for state in back]
    for k in lost_torques:
        back[k] = replace(back[k], tau=np.full(6, math.nan))
    for k in lost_speeds:
        back[k] = replace(back[k], dq=np.full(6, math.nan))
    check = compare(ur10e, JOINT, ANGLE, there, back)
    assert (check.ok, found in check.detail) == (True, True), check
