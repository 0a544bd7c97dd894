"""A wrong mounting is refused with the direction of gravity, and so is a torque without gravity.

Here the arm hangs on a wall or a ceiling and its model stands on the floor.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.known_truth import fourier_motion, recorded, varied
from benchmarks.wrong_data import family, within
from calib.gate.gate import gate
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.rigid_body import RigidBody

X, Y, ASKEW = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0)
LOAD = ArmEffect("payload", None, {"mass": 2.0, "com_x": 0.0, "com_y": 0.05, "com_z": 0.05})
PULL = ArmEffect("tool_force", None, {"force_x": 0.0, "force_y": 0.0, "force_z": 20.0})


def turned(arm: Arm, degrees: float, axis: tuple[float, float, float]) -> Arm:
    """The arm mounted with its base turned."""
    gravity = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).apply(arm.gravity)
    return replace(arm, tree=replace(arm.tree, gravity=gravity))


def of(truth: Arm, motion: int) -> Log:
    return recorded(truth, within(truth, fourier_motion(truth, motion, 20.0, 100.0)), motion)


@pytest.mark.parametrize("name", ["servo6", "ur10e"])
@pytest.mark.parametrize(("degrees", "axis"), [(180.0, X), (90.0, X), (90.0, Y), (135.0, ASKEW)])
def test_gravity_is_named_as_it_pulls(name: str, degrees: float, axis: tuple[float, float, float]) -> None:
    arm = load_arm(name)
    truth = turned(varied(arm, 4, 0.05), degrees, axis)
    refusal = gate(arm, [of(truth, 34)], family).refusal
    assert refusal is not None
    (vector,) = re.findall(r"gravity pulls along \((.*?)\) m/s\^2", refusal)
    assert np.array([float(x) for x in vector.split(",")]) == pytest.approx(truth.gravity, abs=0.5)
    (angle,) = re.findall(r"turned by (\d+) deg", refusal)
    assert int(angle) == pytest.approx(degrees, abs=5)
    assert gate(turned(arm, degrees, axis), [of(truth, 34)], family).refusal is None


@pytest.mark.parametrize("effect", [LOAD, PULL], ids=lambda e: e.effect)
@pytest.mark.parametrize("name", ["servo6", "ur10e"])
def test_a_load_or_a_pull_hides_no_mounting_and_is_none(name: str, effect: ArmEffect) -> None:
    arm = load_arm(name)
    assert gate(arm, [of(with_effect(varied(arm, 5, 0.05), effect), 35)], family).refusal is None
    hanging = with_effect(turned(varied(arm, 5, 0.05), 180.0, X), effect)
    assert "turned by 1" in str(gate(arm, [of(hanging, 35)], family).refusal)


def test_a_base_that_is_askew_is_left_to_diagnosis() -> None:
    arm = load_arm("ur10e")
    for degrees in (5.0, 45.0):
        assert gate(arm, [of(turned(varied(arm, 6, 0.05), degrees, ASKEW), 36)], family).refusal is None


def test_a_wrong_sign_shows_beside_the_mounting() -> None:
    arm = load_arm("ur10e")
    log = of(turned(varied(arm, 4, 0.05), 180.0, X), 34)
    log = replace(log, tau=log.tau * np.array([1, 1, -1, 1, 1, 1]))
    found = gate(arm, [log], family)
    assert {check.check for check in found.checks if not check.ok} == {"gravity", "torque"}
    assert "elbow_joint" in str(found.refusal)


@pytest.mark.parametrize("joint", [1, 2])
def test_readings_that_are_no_numbers_are_no_crash(joint: int) -> None:
    arm = load_arm("ur10e")
    log = of(turned(varied(arm, 4, 0.05), 180.0, X), 34)
    tau = log.tau.copy()
    tau[:, joint] = np.nan
    assert "mounted differently" in str(gate(arm, [replace(log, tau=tau, current=np.full_like(tau, np.nan))], family).refusal)


@pytest.mark.parametrize("share", [1.0, 0.95])
@pytest.mark.parametrize("name", ["servo6", "ur10e"])
def test_a_torque_that_leaves_out_gravity_is_refused(name: str, share: float) -> None:
    arm = load_arm(name)
    log = of(varied(arm, 4, 0.05), 34)
    found = gate(arm, [replace(log, tau=log.tau - share * RigidBody(arm).gravity_torque(log.q))], family)
    assert share < 1.0 or "leaves out gravity" in found.causes[0].sentence
    assert found.refusal is not None
    assert gate(arm, [log], family).refusal is None


def test_a_model_without_gravity_has_no_direction_to_compare() -> None:
    arm = load_arm("ur10e")
    floating = replace(arm, tree=replace(arm.tree, gravity=np.zeros(3)))
    assert gate(floating, [of(varied(floating, 4, 0.05), 34)], family).refusal is None
