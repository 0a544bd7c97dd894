"""A spring and a ripple that one ripple of another period fits better than either of them."""

from __future__ import annotations

import numpy as np

from calib.diagnosis import selection
from calib.diagnosis.fit import fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.pairs import paired
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


def test_a_wrong_first_effect_gives_way_to_the_two_that_it_imitates(ur10e: Arm) -> None:
    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        true = ur10e
        for item in TRUTH:
            true = with_effect(true, item)
        return predict(true, motion) - predict(ur10e, motion)

    measurements = warmed([measured(recording(ur10e, seed, hidden), ur10e) for seed in (1, 2)])
    baseline = selection.started(measurements, Hypothesis.nominal(ur10e))
    stuck = fit(measurements, baseline.hypothesis.with_effects((WRONG,)), noise=baseline.solved.noise)
    found = selection.SearchResult(baseline, stuck)
    paired(measurements, found)
    assert {(e.effect, e.joint) for e in found.best.accepted} >= {(e.effect, e.joint) for e in TRUTH}
    assert cost(found.best) < cost(stuck)


def test_what_leaves_no_structure_stays(ur10e: Arm) -> None:
    measurements = warmed([measured(recording(ur10e, seed), ur10e) for seed in (1, 2)])
    found = selection.search(measurements, Hypothesis.nominal(ur10e))
    before = found.best
    paired(measurements, found)
    assert found.best is before
