"""A fault at one joint is enough: no rule of the guard needs a second joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.guard import QUANTISATION
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME
from tests.safety.guarded import guard_of, stopped_by
from tests.safety.perfect import PerfectDriver


def only(joint: int, value: float) -> np.ndarray:
    row = np.zeros(6)
    row[joint] = value
    return row


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize(
    ("name", "value", "message"), [("q", np.nan, "not complete"), ("dq", np.nan, "not complete"), ("dq", 0.2, "the arm moves")]
)
def test_before_motion(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, joint: int, name: str, value: float, message: str
) -> None:
    driver.fault = lambda state, k: replace(state, **{name: getattr(state, name) + only(joint, value)})
    with pytest.raises(SafetyStop, match=message):
        guard_of(driver, arm, cell, clearance)
    assert driver.sent == []


@pytest.mark.parametrize("joint", range(6))
def test_a_motion_that_begins_elsewhere(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, joint: int
) -> None:
    driver.q = HOME + only(joint, 0.02)
    with pytest.raises(SafetyStop, match=f"away from the position of {arm.joint_names[joint]}"):
        guard_of(driver, arm, cell, clearance).run(cleared, "friction")
    assert driver.sent == []


def test_a_motion_that_begins_at_the_speed_of_one_joint(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance
) -> None:
    t = np.linspace(0, 0.5, 251)
    speed = 0.05 * np.cos(np.pi * t)
    zero = np.zeros((len(t), 6))
    q, dq, ddq = HOME + zero, zero.copy(), zero.copy()
    q[:, 3] += 0.05 / np.pi * np.sin(np.pi * t)
    dq[:, 3], ddq[:, 3] = speed, -0.05 * np.pi * np.sin(np.pi * t)
    moving = clear(Trajectory(t, q, dq, ddq), arm, cell, driver.rate, clearance=clearance)
    with pytest.raises(SafetyStop, match="or at another speed"):
        guard_of(driver, arm, cell, clearance).run(moving, "friction")
    assert driver.sent == []


@pytest.mark.parametrize("joint", range(6))
def test_a_command_that_was_sent_otherwise(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, joint: int
) -> None:
    driver.send = lambda q, dq, tau: q + only(joint, 2 * QUANTISATION)  # type: ignore[method-assign]
    assert "it must send a command or raise" in str(stopped_by(guard_of(driver, arm, cell, clearance), cleared))
