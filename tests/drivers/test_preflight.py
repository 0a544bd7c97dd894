"""Each preflight check, made to fail on the mock arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.driver import Check, DeviceInfo
from drivers.mock import MockDriver
from drivers.preflight import held_by, preflight
from drivers.remedies import BUSY, CAN_RATE, WIRED_RATE
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import Cell, load_cell
from sim.effects import with_effect
from sim.joint_state import JointState, Status
from sim.prediction import at_rest


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur10e")


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell("mock-ur10e")


def checked(
    arm: Arm,
    cell: Cell,
    fault: Callable[[JointState], JointState] | None = None,
    info: Callable[[DeviceInfo], DeviceInfo] | None = None,
) -> dict[str, Check]:
    with MockDriver.from_cell(cell, arm) as driver:
        driver.faults += [fault] if fault else []
        driver.info = info(driver.info) if info else driver.info
        return {check.name: check for check in preflight(driver, cell, 0.2)}


def test_a_healthy_arm_passes_and_what_it_does_not_say_stays_open(arm: Arm, cell: Cell) -> None:
    checks = checked(arm, cell)
    assert [c.name for c in checks.values() if c.ok is False] == []
    assert checks["payload"].ok is None


def test_the_remedy_for_a_late_device_is_one_that_it_has(arm: Arm, cell: Cell) -> None:
    """No cable leads to an emulator, and a CAN bus has no clients."""

    def remedies(driver: str, **options: object) -> set[str]:
        table = cell.table.model_copy(update={"driver": driver, "options": options})
        with MockDriver.from_cell(cell, arm) as mock:
            mock.faults.append(lambda s: replace(s, t_device=2.0 * s.t_device))
            checks = preflight(mock, replace(cell, table=table), 0.2)
        return {check.remedy for check in checks if check.name in ("rate", "device clock") and check.ok is False}

    assert remedies("ur_rtde", host="127.0.0.2") == remedies("can_servo", channel="runs/emulated-servo6.tty") == {BUSY}
    assert WIRED_RATE in remedies("ur_rtde", host="192.168.0.2")
    assert WIRED_RATE in remedies("ur_rtde", host="127.0.0.1")
    assert CAN_RATE in remedies("can_servo", interface="socketcan", channel="can0")


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("status", lambda s: replace(s, status=Status.PROTECTIVE_STOP)),
        ("joint limits", lambda s: replace(s, q=s.q + np.array([0, 0, 9.0, 0, 0, 0]))),
        ("joint limits", lambda s: replace(s, q=s.q * np.nan)),
        ("torque at rest", lambda s: replace(s, tau=-s.tau)),
        ("torque at rest", lambda s: replace(s, tau=s.tau[::-1])),
        ("device clock", lambda s: replace(s, t_device=0.0)),
        ("device clock", lambda s: replace(s, t_device=2.0 * s.t_device)),
        ("rate", lambda s: replace(s, t_device=2.0 * s.t_device)),
    ],
)  # fmt: skip
def test_a_reading_that_is_wrong_fails_its_check_with_a_remedy(
    arm: Arm, cell: Cell, name: str, fault: Callable[[JointState], JointState]
) -> None:
    check = checked(arm, cell, fault)[name]
    assert check.ok is False
    assert check.remedy


@pytest.mark.parametrize(
    ("name", "change", "ok"),
    [
        ("payload", {"payload_mass": 0.0, "payload_com": (0.0, 0.0, 0.0)}, True),
        ("payload", {"payload_mass": 1.5, "payload_com": (0.0, 0.0, 0.05)}, False),
        ("payload", {"payload_mass": float("nan"), "payload_com": (0.0, 0.0, 0.0)}, False),
        ("mounting", {"gravity": (0.0, 0.3, -9.8)}, True),
        ("mounting", {"gravity": (0.0, 0.0, 9.81)}, False),
        ("mounting", {"gravity": (0.0, 9.81, 0.0)}, False),
        ("mounting", {"gravity": (0.0, 0.0, 0.0)}, False),
        ("mounting", {"gravity": None}, None),
    ],
)
def test_what_the_device_believes_is_compared(
    arm: Arm, cell: Cell, name: str, change: dict[str, object], ok: bool | None
) -> None:
    check = checked(arm, cell, info=lambda info: replace(info, **change))[name]
    assert check.ok is ok


def test_a_declared_payload_is_part_of_the_torque_at_rest(arm: Arm, cell: Cell) -> None:
    heavy = replace(
        cell,
        table=cell.table.model_validate(
            {**cell.table.model_dump(by_alias=True), "payload": {"mass": 12.0, "com": [0.0, 0.0, 0.2]}}
        ),
    )
    assert checked(arm, heavy)["torque at rest"].ok is False


def test_a_spring_of_the_arm_file_is_part_of_the_torque_at_rest(arm: Arm, cell: Cell) -> None:
    spring = ArmEffect("joint_spring", arm.joint_names[1], {"stiffness": 60.0, "rest_angle": -3.5})
    sprung = with_effect(arm, spring)
    fitted = checked(sprung, cell)["torque at rest"]
    assert fitted.ok is True, fitted.detail
    # a spring of the arm file that the arm does not have is noticed
    with MockDriver.from_cell(cell, arm) as driver:
        driver.arm = sprung
        assert {check.name: check for check in preflight(driver, cell, 0.2)}["torque at rest"].ok is False
    q = np.array([arm.q_min, arm.q_max]) / 4
    assert held_by(sprung, q, at_rest(sprung, q), np.zeros(arm.n)).miss == 0.0
    assert held_by(arm, q, at_rest(sprung, q), np.zeros(arm.n)).miss > 1.0


def test_speed_and_temperature_are_among_the_answers(arm: Arm, cell: Cell) -> None:
    driver = MockDriver.from_cell(cell, arm)
    with driver:
        found = {check.name: check for check in preflight(driver, cell, 0.1)}
        assert found["speed"].ok is True
        assert "stands still" in found["speed"].detail
        assert "25 to 25 degC" in found["temperature"].detail
        driver.faults.append(
            lambda state: replace(state, dq=state.dq + np.array([0, 0.3, 0, 0, 0, 0]), temperature=np.full(6, np.nan))
        )
        found = {check.name: check for check in preflight(driver, cell, 0.1)}
        assert (found["speed"].ok, "the arm moves" in found["speed"].detail) == (None, True)
        assert arm.joint_names[1] in found["speed"].detail
        assert found["temperature"].ok is None
