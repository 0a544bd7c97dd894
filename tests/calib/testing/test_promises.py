"""The promise suites pass for everything in the package and detect what a careless implementation gets wrong."""

from dataclasses import replace

import numpy as np
import pytest

from calib.main import COMMANDS
from calib.testing import assert_kept, broken, check_arm, check_command, check_driver, check_effect
from drivers.driver import DeviceInfo, Driver
from drivers.mock import MockDriver
from sim.arm import load_arm
from sim.cell import load_cell
from sim.clock import SimulatedClock
from sim.effects import EFFECTS
from sim.effects.coulomb_friction import CoulombFriction
from sim.joint_state import JointState
from sim.resources import shipped_configs

ARMS = sorted(p.parent.name for p in shipped_configs().glob("arms/*/arm.toml"))


@pytest.fixture(scope="module")
def arm():
    return load_arm("ur10e")


def test_the_mock_keeps_every_promise_of_a_driver(arm):
    cell = load_cell("mock-ur10e")
    assert_kept(
        check_driver(
            lambda: MockDriver.from_cell(cell, arm),
            arm,
            standing=np.array(cell.table.home),
            position=lambda d: d.plant.read(0.0).q,
        )
    )


class Careless(Driver):
    """A faulty driver that homes in connect, clamps, accepts anything and repeats its last sample.

    It raises in close and needs no connection.
    """

    def __init__(self, arm):
        self.arm, self.rate, self.clock = arm, 500.0, SimulatedClock()
        self.q = np.full(arm.n, 0.5)

    def connect(self):
        self.q = np.zeros(self.arm.n)
        return DeviceInfo(model="", serial="", firmware="", rate=100.0)

    def read(self):
        nan = np.full(self.arm.n, np.nan)
        return JointState(1.0, 1.0, self.q, nan, nan, nan, nan)

    def send(self, q, dq, tau):
        self.q = np.clip(np.nan_to_num(np.resize(q, self.arm.n)), self.arm.q_min, self.arm.q_max)
        return self.q

    def stop(self):
        pass

    def close(self):
        raise OSError("bad file descriptor")


def test_a_careless_driver_is_found_out_in_every_place(arm):
    names = {p.name for p in broken(check_driver(lambda: Careless(arm), arm, standing=np.full(arm.n, 0.5)))}
    assert names == {
        "before connect, read is refused",
        "before connect, send is refused",
        "before connect, stop and close are harmless",
        "connect reports what the device is",
        "connect moves nothing",
        "readings are new: both clocks advance, and no reading repeats",
        "readings come at the stated rate",
        "a command of NaN is refused",
        "a command of infinity is refused",
        "a command of one number too many is refused",
        "a command of one NaN among good numbers is refused",
        "a command whose speed is NaN is refused",
        "a command whose torque is NaN is refused",
        "send never clamps",
        "close ends without an error, also when repeated",
        "after close, send is refused",
        "with `with`, the device is released after an error",
        "a closed device can be connected again",
    }


@pytest.mark.parametrize("name", ARMS)
def test_every_shipped_arm_keeps_its_promises(name):
    """Arms of one family differ only in numbers, so a motion is designed for two arms."""
    assert_kept(check_arm(name, plan=name in ("servo6", "ur10e")))


def test_an_arm_that_cannot_be_is_found_out(arm, tmp_path):
    folder = tmp_path / "weak"
    text = (arm.model_path.parent / "arm.toml").read_text()
    folder.mkdir()
    (folder / "model.xml").write_text(arm.model_text)
    (folder / "arm.toml").write_text(text.replace("tau_max = [330.0, 330.0", "tau_max = [330.0, 3.0"))
    assert {p.name for p in broken(check_arm(folder))} == {
        "its motors can hold it", "one posture is free of self-collision, and a motion around it fits the limits",
    }  # fmt: skip
    assert [p.name for p in broken(check_arm(tmp_path / "nowhere"))] == ["it loads"]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_every_effect_of_the_catalogue_keeps_its_promises(effect):
    assert_kept(check_effect(effect))


def test_a_careless_effect_is_found_out(arm):
    class Wrong(CoulombFriction):
        looks = ""
        parameters = (replace(CoulombFriction.parameters[0], unit="", grid=(-1.0,)),)

        def imitators(self, path, joint):
            return {"a torque without an axis for its parts": path.dq[:, joint]}

    names = {p.name for p in broken(check_effect(Wrong(), arm))}
    assert {
        "the catalogue has it under its name",
        "it states what it is, how it looks, and its source",
        "every parameter has a unit, a meaning, and typical values within its bounds",
        "its imitators are finite torques along the motion",
    } <= names


@pytest.mark.parametrize("name", [*(c for c in COMMANDS if c not in ("arm", "servo")), "arm new", "arm drive"])
def test_every_command_keeps_its_promises(name):
    assert_kept(check_command(name, ["coulomb_friction"] if name == "effects" else None))


def test_a_command_that_is_not_there_is_found_out():
    assert "it is in the list of commands" in {p.name for p in broken(check_command("dance"))}
