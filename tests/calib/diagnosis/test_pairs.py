"""Two effects that one wrong effect fits better than either of them alone, and two pairs that fit equally well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis import selection
from calib.diagnosis.acceptance import assess
from calib.diagnosis.fit import fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.pairs import paired, with_rival_pairs
from calib.diagnosis.prices import cost
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import recording

JOINT = "elbow_joint"
TRUTH = (
    ArmEffect("joint_spring", JOINT, {"stiffness": 12.0, "rest_angle": 0.4}),
    ArmEffect("torque_ripple", JOINT, {"amplitude": 4.0, "cycles": 6.0, "phase": 0.7}),
)
WRONG = ArmEffect("torque_ripple", JOINT, {"amplitude": 6.0, "cycles": 2.0, "phase": -0.2})


WRIST = "wrist_1_joint"
OFFSETS = (
    ArmEffect("encoder_offset", WRIST, {"offset": -0.05}),
    ArmEffect("torque_offset", WRIST, {"offset": 0.3}),
)
SPRING = ArmEffect("joint_spring", WRIST, {"stiffness": 0.1, "rest_angle": -4.0})


# while a joint slides, friction that differs between the directions is an offset
@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "wrong", "alike"),
    [(TRUTH, WRONG, {}), pytest.param(OFFSETS, SPRING, {"asymmetric_friction": "torque_offset"}, marks=pytest.mark.slow)],
)
def test_a_wrong_first_effect_gives_way_to_the_two_that_it_imitates(
    ur10e: Arm, truth: tuple[ArmEffect, ...], wrong: ArmEffect, alike: dict[str, str]
) -> None:
    """The ripple leaves structure. The spring leaves none, but an offset alone has nearly its gain."""

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        true = ur10e
        for item in truth:
            true = with_effect(true, item)
        return predict(true, motion) - predict(ur10e, motion)

    measurements = warmed([measured(recording(ur10e, seed, hidden), ur10e) for seed in (1, 2)])
    baseline = selection.started(measurements, Hypothesis.nominal(ur10e))
    stuck = fit(measurements, baseline.hypothesis.with_effects((wrong,)), noise=baseline.solved.noise)
    found = paired(measurements, selection.SearchResult(baseline, stuck))
    assert {(alike.get(e.effect, e.effect), e.joint) for e in found.best.accepted} >= {(e.effect, e.joint) for e in truth}
    assert cost(found.best) < cost(stuck)


def test_what_leaves_no_structure_stays(ur10e: Arm) -> None:
    measurements = warmed([measured(recording(ur10e, seed), ur10e) for seed in (1, 2)])
    found = selection.search(measurements, Hypothesis.nominal(ur10e))
    assert paired(measurements, found) is found


def rivals_of(arm: Arm, truth: tuple[ArmEffect, ...], named: tuple[ArmEffect, ...]) -> list[tuple[tuple[str, str | None], ...]]:
    """The rivals of two named effects in recordings of an arm with `truth`."""
    true = arm
    for item in truth:
        true = with_effect(true, item)
    measurements = warmed([measured(recording(arm, seed, truth=true), arm) for seed in (1, 2)])
    baseline = selection.started(measurements, Hypothesis.nominal(arm))
    best = fit(measurements, baseline.hypothesis.with_effects(named), noise=baseline.solved.noise, like=baseline.models)
    return [a.rivals for a in with_rival_pairs(measurements, best, assess(measurements, best, ()))]


def test_a_pair_that_fits_as_well_stands_beside_the_names(ur10e: Arm) -> None:
    """Nearly all torque of wrist 3 is friction and reflected inertia. More of both is a gain with less viscous friction."""
    stated = replace(ur10e, prior=ur10e.prior.model_copy(update={"coulomb": 0.04, "viscous": 0.04, "rotor": 0.1}))
    wrist = "wrist_3_joint"
    truth = (ArmEffect("coulomb_friction", wrist, {"coulomb": 3.15}), ArmEffect("rotor_inertia", wrist, {"inertia": 0.73}))
    names = (ArmEffect("torque_gain", wrist, {"gain": 1.4}), ArmEffect("viscous_friction", wrist, {"viscous": 1.2}))
    assert rivals_of(stated, truth, names) == [(("coulomb_friction", wrist),), (("rotor_inertia", wrist),)]


def test_a_pair_that_nothing_imitates_has_no_rivals(ur10e: Arm) -> None:
    named = (ArmEffect("coulomb_friction", JOINT, {"coulomb": 15.0}), ArmEffect("torque_offset", JOINT, {"offset": 5.0}))
    assert rivals_of(ur10e, named, named) == [(), ()]
