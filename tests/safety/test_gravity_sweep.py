"""Slow moves there and back cancel friction; the remaining gravity torque identifies the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.driver import Check
from drivers.mock import MockDriver
from drivers.preflight import GRAVITY_DOUBT, UNEVEN, ZERO_DOUBT
from drivers.torque_constants import constants_from
from drivers.ur_rtde import family
from safety.collision import Clearance
from safety.gravity_sweep import PLACES, at_places, lines_from
from safety.joint_test import try_joints
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import Cell, load_cell
from sim.clock import SimulatedClock
from sim.effects import with_effect
from sim.joint_state import JointState
from sim.plant import Plant
from sim.rigid_body import RigidBody

RATE = 100.0


class OfFamily(MockDriver):
    """The mock with the gravity check of the UR driver."""

    def gravity(self, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> list[Check]:
        return [family.torque(self.arm, None, q, tau, friction)]


@pytest.fixture(scope="module")
def ur10e() -> Arm:
    return load_arm("ur10e")


@pytest.fixture(scope="module")
def mock_cell() -> Cell:
    return load_cell("mock-ur10e")


def tried(truth: Arm, arm: Arm, cell: Cell, drive: Arm | None = None) -> dict[str, Check]:
    driver = OfFamily(Plant(truth, drive=drive or truth), arm, RATE, SimulatedClock(), start=cell.table.home)
    with driver:
        begin = driver.read().q
        checks = try_joints(driver, cell)
        assert driver.read().q == pytest.approx(begin, abs=5e-3)
    return {check.name: check for check in checks}


def test_the_arm_of_the_cell_passes_with_any_friction(ur10e: Arm, mock_cell: Cell) -> None:
    truth = ur10e
    for joint, coulomb in zip(ur10e.joint_names, (30.0, 9.0, 18.0, 1.0, 5.0, 1.0), strict=True):
        truth = with_effect(truth, ArmEffect("coulomb_friction", joint, {"coulomb": coulomb}))
    found = tried(truth, ur10e, mock_cell)
    assert found["gravity torque"].ok is True
    assert found["arm of the family, gravity torque"].ok is True
    assert "that of a ur10e" in found["arm of the family, gravity torque"].detail


@pytest.mark.parametrize("name", ["ur16e", *(pytest.param(other, marks=pytest.mark.slow) for other in ("ur5e", "ur30"))])
def test_another_arm_of_the_family_is_named(ur10e: Arm, mock_cell: Cell, name: str) -> None:
    """At a single pose, with the friction that a UR10e states, a UR16e looks like a UR10e; the sweep distinguishes them."""
    found = tried(load_arm(name), ur10e, mock_cell)
    assert found["gravity torque"].ok is False
    check = found["arm of the family, gravity torque"]
    assert check.ok is False
    assert f"{name}" in check.detail.partition("this looks like")[2]
    assert check.assume == "arm-as-stated"


def test_a_tool_that_nobody_declared_is_found(ur10e: Arm, mock_cell: Cell) -> None:
    load = ArmEffect("payload", None, {"mass": 5.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.1})
    carries = with_effect(ur10e, load)
    found = tried(carries, ur10e, mock_cell)
    assert found["gravity torque"].ok is False
    assert "tool that the cell file does not declare" in found["gravity torque"].remedy


@pytest.mark.slow
def test_a_joint_that_failed_its_two_degrees_is_not_swept(ur10e: Arm, mock_cell: Cell) -> None:
    driver = OfFamily(Plant(ur10e), ur10e, RATE, SimulatedClock(), start=mock_cell.table.home)
    driver.faults.append(lambda state: replace(state, tau=state.tau * [-1, 1, 1, 1, 1, 1], current=state.current * np.nan))
    with driver:
        checks = try_joints(driver, mock_cell)
    assert [c.name for c in checks] == [f"move {name}" for name in ur10e.joint_names]


def test_no_line_is_driven_where_none_can_be_verified(ur10e: Arm, mock_cell: Cell) -> None:
    home = np.array(mock_cell.table.home)
    narrow = replace(ur10e, q_min=home - 0.2, q_max=home + 0.2)
    driver = OfFamily(Plant(ur10e), narrow, RATE, SimulatedClock(), start=home)
    assert lines_from(home, driver, mock_cell, Clearance(narrow, mock_cell), 0.0) == []


def by_current(truth: Arm, cell: Cell, constant: np.ndarray, stated: Arm) -> dict[str, Check]:
    """The checks of an arm whose device reports currents and whose file has no torque constant."""
    driver = OfFamily(Plant(truth), replace(stated, torque_constant=None), RATE, SimulatedClock(), start=cell.table.home)
    driver.faults.append(lambda state: replace(state, current=state.tau / constant, tau=np.full(6, np.nan)))
    with driver:
        return {check.name: check for check in try_joints(driver, cell)}


@pytest.mark.slow
def test_currents_give_torque_constants_where_gravity_loads_a_joint(ur10e: Arm, mock_cell: Cell) -> None:
    found = by_current(ur10e, mock_cell, np.array([9.0, 11.0, 12.0, 8.0, 8.0, 8.0]), ur10e)["torque constants"]
    assert found.ok is None
    assert "shoulder_lift_joint 11 ± 1," in found.detail
    assert "elbow_joint 12 ± " in found.detail
    unknown = found.detail.partition("unknown, because gravity hardly loads them here: ")[2]
    assert unknown.startswith("shoulder_pan_joint, ")
    assert "wrist_3_joint" in unknown


def test_constants_are_as_sure_as_masses_friction_and_scatter(ur10e: Arm) -> None:
    """The true constants are within three standard deviations in more than 97 % of cases.

    Poses are random; masses, torque zeros and uneven friction are off by their stated uncertainties.
    """
    rng, inside, count = np.random.default_rng(5), 0, 0
    truth = np.array([12.0, 12.0, 10.0, 8.0, 8.0, 8.0])
    for _ in range(200):
        q = rng.uniform(-1.5, 1.5, (9, 6))
        torque = (
            RigidBody(ur10e).gravity_torque(q) * rng.normal(1.0, GRAVITY_DOUBT, 6)
            + rng.normal(0.0, ZERO_DOUBT, 6) * ur10e.tau_max
        )
        friction = np.full((9, 6), 0.6)
        current = torque / truth + UNEVEN * friction * rng.choice((-1.0, 1.0), 6) + rng.normal(0.0, 0.05, (9, 6))
        found = constants_from(ur10e, q, current, friction)
        known = np.isfinite(found.value)
        inside += int(np.sum(np.abs(found.value - truth)[known] < 3 * found.std[known]))
        count += int(known.sum())
    assert count >= 400
    assert inside > 0.97 * count


def line(count: int, tau: float) -> list[JointState]:
    zero, nothing = np.zeros(2), np.full(2, np.nan)
    rows = []
    for k, share in enumerate(np.linspace(0, 1, count)):
        q = share * np.array([0.4, -0.3])
        rows.append(JointState(0.01 * k, 0.01 * k, q, zero, np.array([10 * q[0] + tau, 5 * q[1]]), nothing, nothing))
    return rows


def test_torque_is_that_of_the_place_and_nothing_where_readings_are_too_few(ur10e: Arm) -> None:
    arm = replace(ur10e, torque_constant=None)
    begin, end = np.zeros(2), np.array([0.4, -0.3])
    q, torque = at_places(line(400, 3.0), begin, end, arm)
    np.testing.assert_allclose(q, np.array(PLACES)[:, None] * end)
    np.testing.assert_allclose(torque, np.column_stack((10 * q[:, 0] + 3.0, 5 * q[:, 1])), atol=1e-9)
    _, silent = at_places(line(10, 3.0), begin, end, arm)
    assert np.isnan(silent).all()
