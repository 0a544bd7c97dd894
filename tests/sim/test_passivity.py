"""Friction that drives its joint is found, at the speed where it drives most; friction that brakes is not reported."""

from __future__ import annotations

import numpy as np
import pytest

from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import effect_named, with_effect
from sim.passivity import DrivingFriction, driving_friction, steady_friction

JOINT, J = "wrist_3_joint", 5


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur10e")


def with_law(arm: Arm, **terms: float) -> Arm:
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {k.replace("__", "."): v for k, v in terms.items()}
    return with_effect(arm, ArmEffect("friction_law", JOINT, law))


def own(arm: Arm, effect: str, parameter: str) -> float:
    item = arm.effect(effect, JOINT)
    assert item is not None
    return item.parameters[parameter]


@pytest.mark.parametrize("speed", [0.05, 1.5])
def test_steady_friction_is_dry_and_viscous_friction(arm: Arm, speed: float) -> None:
    expected = own(arm, "coulomb_friction", "coulomb") + speed * own(arm, "viscous_friction", "viscous")
    assert steady_friction(arm, np.full(6, speed))[J] == pytest.approx(expected, rel=1e-6)


def test_what_differs_between_the_directions_drives_no_joint(arm: Arm) -> None:
    uneven = with_effect(arm, ArmEffect("asymmetric_friction", JOINT, {"half_difference": 50.0}))
    shifted = with_effect(uneven, ArmEffect("torque_offset", JOINT, {"offset": -50.0}))
    np.testing.assert_allclose(steady_friction(shifted, np.ones(6)), steady_friction(arm, np.ones(6)))
    assert driving_friction(shifted, arm.dq_max, np.zeros(6)) == []


def test_friction_that_falls_below_zero_drives_at_its_fastest(arm: Arm) -> None:
    viscous, coulomb = own(arm, "viscous_friction", "viscous"), own(arm, "coulomb_friction", "coulomb")
    falls = with_law(arm, power_1=-viscous - 2.0 * coulomb)
    assert driving_friction(falls, np.full(6, 0.4), np.zeros(6)) == []
    (found,) = driving_friction(falls, np.full(6, 1.5), np.zeros(6))
    assert found == DrivingFriction(JOINT, pytest.approx(-2.0 * coulomb, rel=1e-3), pytest.approx(1.5))
    assert driving_friction(falls, np.full(6, 1.5), np.full(6, 3.0 * coulomb)) == []


def test_friction_that_drives_at_a_speed_between_is_found_there(arm: Arm) -> None:
    coulomb = own(arm, "coulomb_friction", "coulomb")
    dips = with_law(arm, power_1=-8.0 * coulomb, power_2=8.0 * coulomb)
    (found,) = driving_friction(dips, np.full(6, 1.0), np.zeros(6))
    assert found.joint == JOINT
    assert 0.3 < found.speed < 0.7
