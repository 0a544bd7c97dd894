"""The robot is the one of the cell file: its model, its serial number, and the torque that holds it up."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers import open_driver
from drivers.driver import Check
from drivers.ur_rtde import checks, family
from drivers.ur_rtde.dashboard import ControllerInfo
from drivers.ur_rtde.driver import UrDriver
from drivers.ur_rtde.options import UrOptions
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.primary import SAFETY_CHECKSUM
from sim.emulated.ur.robot import STOPPED
from sim.errors import DeviceError
from sim.resources import shipped_configs
from sim.rigid_body import RigidBody
from tests.drivers.ur_rtde.conftest import Pair

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
REACHED = np.array([0.0, -0.3, 0.2, -0.4, -1.2, 0.3])  # far out: gravity distinguishes the arms
WRONG = [name for name in family.FAMILY if name not in ("ur10e", "ur12e")]  # the UR12e is a UR10e


def test_the_family_is_every_shipped_ur() -> None:
    assert set(family.FAMILY) == {p.parent.name for p in shipped_configs().glob("arms/ur*/arm.toml")}


@pytest.mark.parametrize("name", WRONG)
def test_twelve_of_twelve_wrong_arms_are_refused_by_their_model(cell: Callable[..., Cell], arm: Arm, name: str) -> None:
    polyscope = "3.15.4" if family.FAMILY[name][1] else "5.25.1"
    path = cell(polyscope=polyscope).path
    # without the waiver that the cell fixture adds for a CB3
    path.write_text(path.read_text().replace('assume = ["arm-as-stated"]\n', "") + f'arm = "{name}"\n')
    table = load_cell(path)
    emulator, driver = open_emulator(table, arm), open_driver(table, arm)
    assert isinstance(driver, UrDriver)
    emulator.start()
    try:
        with pytest.raises(DeviceError, match=rf"this looks like a .*\b{name}\b"):
            driver.connect()
    finally:
        driver.close()
        emulator.stop()


@pytest.mark.parametrize("name", WRONG)
def test_the_torque_alone_shows_a_wrong_arm_that_reaches_out(arm: Arm, name: str) -> None:
    tau = RigidBody(load_arm(name)).gravity_torque(REACHED)[0]
    check = family.torque(arm, None, REACHED, tau)
    if name in INDISTINCT:
        assert (check.ok, f"{name}" in check.detail) == (True, True)
    else:
        assert check.ok is False


# within friction and 5 % of gravity of a UR10e at this posture; model and kinematics distinguish these
INDISTINCT = {"ur10", "ur15", "ur16e", "ur18"}


def test_friction_at_rest_either_way_is_no_other_arm(arm: Arm) -> None:
    rng = np.random.default_rng(3)
    friction = np.array([17, 19, 9.5, 2.6, 2.4, 2.2])
    for q in (HOME, REACHED):
        tau = RigidBody(arm).gravity_torque(q)[0] + friction * rng.choice([-1.0, 1.0], 6)
        assert family.torque(arm, None, q, tau).ok is True


def test_torque_that_is_not_a_number_is_not_compared_and_one_that_is_infinite_fits_nobody(arm: Arm) -> None:
    assert family.torque(arm, None, HOME, np.full(6, np.nan)).ok is None
    assert family.torque(arm, None, HOME, np.full(6, 1e9)).ok is False


@pytest.mark.parametrize(
    ("reported", "major", "names"),
    [("UR5", 5, ["ur5e", "ur7e"]), ("UR5", 3, ["ur5"]), ("UR5e", 10, ["ur5e", "ur7e"]), ("UR8_LONG", 5, ["ur8l"]),
     ("UR8 Long", 10, ["ur8l"]), ("UR99", 5, []), ("", 5, [])],
)  # fmt: skip
def test_what_a_controller_calls_itself(reported: str, major: int, names: list[str]) -> None:
    assert family.called(reported, major) == names


@pytest.mark.parametrize(
    ("name", "of"), [("ur10e", "ur10e"), ("ur10e-20231", "ur10e"), ("ur10", "ur10"), ("servo6", None), ("ur100", None)]
)
def test_the_arm_that_a_folder_is_of(arm: Arm, name: str, of: str | None) -> None:
    from dataclasses import replace

    assert family.member(replace(arm, name=name)) == of


def test_the_serial_number_is_pinned_at_first_use() -> None:
    info = ControllerInfo("5.25.1", serial="20231")
    first = checks.serial(info, UrOptions(host="192.168.1.10"))
    assert first.ok is False
    assert 'serial = "20231"' in first.remedy
    assert checks.serial(info, UrOptions(host="127.0.0.1")).ok is False, "where a tunnel to a robot ends"
    assert checks.serial(info, UrOptions(host="127.0.0.2")).ok is None
    assert checks.serial(info, UrOptions(host="192.168.1.10", serial="20231")).ok is True
    assert checks.serial(info, UrOptions(host="127.0.0.2", serial="20239")).ok is False
    assert checks.serial(ControllerInfo("3.11"), UrOptions(host="192.168.1.10")).ok is None


@pytest.mark.parametrize(
    ("found", "pinned", "ok"), [(7, None, None), (None, None, None), (7, 7, True), (8, 7, False), (None, 7, False)]
)
def test_a_changed_safety_configuration_is_refused_where_it_is_pinned(
    found: int | None, pinned: int | None, ok: bool | None
) -> None:
    check = checks.safety_checksum(found, UrOptions(host="192.168.1.10", safety_checksum=pinned))
    assert check.ok is ok
    assert found is None or str(found) in check.detail


def test_control_is_not_taken_of_a_robot_with_another_safety_configuration(pair: Pair) -> None:
    emulator, driver = pair()
    reported = next(c for c in driver_checks(driver) if c.name == "safety checksum")
    assert str(SAFETY_CHECKSUM) in reported.detail
    driver.options = driver.options.model_copy(update={"safety_checksum": SAFETY_CHECKSUM + 1})
    with pytest.raises(DeviceError, match="safety configuration"):
        driver.connect()
    assert emulator.robot.runtime_state == STOPPED


def driver_checks(driver: UrDriver) -> list[Check]:
    driver.listen()
    try:
        return driver.checks()
    finally:
        driver.close()


def test_a_cell_may_assume_its_arm(cell: Callable[..., Cell], arm: Arm) -> None:
    path = cell().path
    path.write_text(path.read_text().replace("home =", 'assume = ["arm-as-stated"]\nhome =') + 'model = "UR5"\n')
    table = load_cell(path)
    emulator, driver = open_emulator(table, arm), open_driver(table, arm)
    emulator.start()
    try:
        driver.info = driver.inspect()
        found = {check.name: check for check in driver.checks()}
        assert found["model"].ok is None
        assert "assumes arm-as-stated" in found["model"].detail
    finally:
        driver.close()
        emulator.stop()
