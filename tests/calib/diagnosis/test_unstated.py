"""Arms with unstated friction: it is fitted, an effect hidden beside it is named, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.acceptance import is_nothing
from calib.diagnosis.contact import force_spread
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.motion import measured
from calib.diagnosis.unstated import unstated_keys, with_unstated
from sim.arm import Arm, ArmEffect, load_arm
from sim.prior import spread
from tests.calib.diagnosis.conftest import at, recording

ELBOW, STIFFNESS = 2, 20.0
SPRING = at(ELBOW, lambda q, dq: STIFFNESS * (q - 0.4))
OWN = ("coulomb_friction", "viscous_friction", "rotor_inertia")


@pytest.fixture(scope="module")
def bare(ur10e: Arm) -> Arm:
    """The arm as read from a model file without friction: friction, reflected inertia and offset are unknown."""
    prior = ur10e.prior.model_copy(update={"unknown": ["coulomb", "viscous", "rotor", "offset"]})
    return replace(ur10e, effects=tuple(e for e in ur10e.effects if e.effect not in OWN), prior=prior)


def test_a_spring_is_named_alone_beside_friction_that_nobody_stated(ur10e: Arm, bare: Arm) -> None:
    logs = [recording(bare, seed, SPRING, truth=ur10e, seconds=14.0) for seed in (1, 2)]
    found = diagnose(bare, logs, [recording(bare, 3, SPRING, truth=ur10e, seconds=14.0)])
    (entry,) = found.answer["effects"]
    assert (entry["effect"], entry["joint"]) == ("joint_spring", "elbow_joint")
    assert entry["parameters"]["stiffness"]["value"] == pytest.approx(STIFFNESS, rel=0.05)
    assert found.correction is not None
    corrected = found.correction.of(bare)
    for joint in ur10e.joint_names:
        (true,), (fitted,) = (list(a.effect("coulomb_friction", joint).parameters.values()) for a in (ur10e, corrected))  # type: ignore[union-attr]
        assert fitted == pytest.approx(true, rel=0.15)
    gap = found.answer["gap"]
    assert np.all(np.array(gap["after"]) < 0.3 * np.array(gap["before"]))


def test_with_nothing_hidden_the_friction_is_written_and_nothing_is_named(ur10e: Arm, bare: Arm) -> None:
    found = diagnose(bare, [recording(bare, seed, truth=ur10e, seconds=14.0) for seed in (4, 5)])
    assert found.answer["verdict"] == "no_missing_effect"
    assert found.correction is not None
    gap = found.answer["gap"]
    assert np.all(np.array(gap["after"]) < 0.3 * np.array(gap["before"]))


def test_what_is_stated_is_not_fitted_beforehand(ur10e: Arm) -> None:
    assert unstated_keys(ur10e) == set()
    assert with_unstated(ur10e, [measured(recording(ur10e, 6), ur10e)]) is ur10e


def test_a_number_that_was_fitted_is_no_surer_than_its_standard_deviation(ur10e: Arm) -> None:
    (own,) = [e for e in ur10e.effects if e.effect == "coulomb_friction" and e.joint == "elbow_joint"]
    value = own.parameters["coulomb"]
    unsure = replace(ur10e, effects=tuple(replace(e, std={"coulomb": 2 * value}) if e is own else e for e in ur10e.effects))
    assert spread(unsure)["coulomb"][ELBOW] == pytest.approx(2 * value)
    assert spread(ur10e)["coulomb"][ELBOW] == pytest.approx(ur10e.prior.coulomb * value)


@pytest.mark.parametrize(("value", "nothing"), [(0.0, True), (1.7, True), (-1.7, True), (2.3, False)])
def test_a_size_within_two_standard_deviations_of_none_is_nothing(value: float, nothing: bool) -> None:
    assert is_nothing(ArmEffect("rotor_inertia", "elbow_joint", {"inertia": value}), {"inertia": 1.0}) == nothing
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": value, "rest_angle": 5.0})
    assert is_nothing(spring, {"stiffness": 1.0, "rest_angle": 0.01}) == nothing


def test_a_force_has_a_prior_where_torque_limits_are_not_stated() -> None:
    arm = load_arm("ur10e")
    most = int(np.argmax(arm.tau_max))
    unstated = np.where(np.arange(arm.n) == most, arm.tau_max, np.nan)
    assert force_spread(replace(arm, tau_max=unstated)) == force_spread(arm)
    assert 10.0 < force_spread(replace(arm, tau_max=np.full(arm.n, np.nan))) < 1000.0


def test_a_force_has_a_prior_where_nothing_loads_the_arm() -> None:
    arm = load_arm("ur10e")
    bare = replace(arm, tau_max=np.full(arm.n, np.nan))
    floating = replace(bare, tree=replace(arm.tree, gravity=np.zeros(3)))
    assert force_spread(floating) == force_spread(bare) > 10.0


def test_a_slide_gives_its_force_without_a_lever() -> None:
    arm = load_arm("ur10e")
    gantry = replace(arm, tree=replace(arm.tree, prismatic=np.ones(arm.n, dtype=bool), position=np.zeros((arm.n, 3))))
    assert force_spread(gantry) == pytest.approx(0.25 * np.max(arm.tau_max))
