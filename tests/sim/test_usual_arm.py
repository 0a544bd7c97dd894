"""An emulated arm gets an ordinary drive's values where none are stated; its own loop knows them, the tool does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock import MockDriver
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import load_cell
from sim.effects import with_effect
from sim.prior import EFFECT
from sim.usual_arm import COULOMB, INERTIA, VISCOUS, drive_size, usual_arm

STATED = load_arm("ur10e")


def bare() -> Arm:
    """An arm without stated drives and sensors, except the dry friction of its first joint."""
    own = tuple(e for e in STATED.effects if e.effect not in {effect for effect, _ in EFFECT.values()})
    prior = STATED.prior.model_copy(update={"unknown": ["coulomb", "viscous", "rotor"]})
    arm = replace(STATED, effects=own, prior=prior, incomplete=("sensors",))
    return with_effect(arm, ArmEffect("coulomb_friction", arm.joint_names[0], {"coulomb": 1.5}))


def values(arm: Arm, key: str) -> np.ndarray:
    effect, parameter = EFFECT[key]
    return np.array([e.parameters[parameter] if (e := arm.effect(effect, j)) else 0.0 for j in arm.joint_names])


def test_an_arm_whose_drives_are_stated_stays_as_it_is() -> None:
    assert usual_arm(STATED) == STATED


def test_what_nobody_stated_is_an_ordinary_drives_and_what_is_stated_stays() -> None:
    arm, usual = bare(), usual_arm(bare())
    size = drive_size(arm)
    coulomb = COULOMB * size
    coulomb[0] = 1.5
    assert values(usual, "coulomb") == pytest.approx(coulomb)
    assert values(usual, "viscous") == pytest.approx(VISCOUS * size / arm.dq_max)
    assert values(usual, "rotor") == pytest.approx(INERTIA * size / arm.ddq_max)
    assert np.all(np.asarray(usual.sensors.torque_noise) > 0)


def test_a_drive_is_made_for_what_it_carries_whatever_its_file_lets_it_have() -> None:
    arm = bare()
    strong = replace(arm, tau_max=100 * arm.tau_max)
    assert np.all(drive_size(strong) < strong.tau_max)
    assert drive_size(strong).min() >= drive_size(strong).max() / 6 - 1e-12
    assert np.all(drive_size(replace(arm, tau_max=1e-3 * arm.tau_max)) == pytest.approx(1e-3 * arm.tau_max))


def test_the_mocks_plant_and_its_drive_have_them_and_the_tools_arm_does_not() -> None:
    driver = MockDriver.from_cell(load_cell("mock-ur10e"), bare())
    assert not values(driver.arm, "rotor").any()
    assert np.all(values(driver.plant.arm, "rotor") > 0)
    assert np.all(values(driver.plant.drive, "rotor") > 0)
