"""The curves on a page match the arm that they show: with the right effect the predicted torque meets the measured one."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from calib import evidence
from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.scoring import Scored
from calib.validation.validate import validate
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from tests.calib.conftest import fourier_motion, recorded

PAYLOAD = ArmEffect("payload", None, {"mass": 0.5, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05})
SPRING = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.0})


def found(verdict: str = "effects_found") -> Any:
    """The part of a diagnosis that the pages use: its answer, the accepted effects and the steps of the search."""
    steps = [[Scored(SPRING, 900.0, 2), Scored(PAYLOAD, 40.0, 4)], [Scored(PAYLOAD, 12.0, 4)]]
    return SimpleNamespace(
        answer={"verdict": verdict},
        accepted=(SPRING,),
        steps=steps,
        correction=ArmChange({}, (SPRING,)),
    )


def test_the_right_name_brings_torque_to_what_was_measured(ur5e: Arm) -> None:
    truth = with_effect(ur5e, SPRING)
    log = recorded(truth, fourier_motion(ur5e, 1, seconds=8.0))
    shown = evidence.of_diagnosis(ur5e, truth, log, found())
    elbow = ur5e.joint_index("elbow_joint")
    before, after = (np.sqrt(np.mean((shown["tau"] - shown[k]) ** 2, axis=0)) for k in ("before", "after"))
    assert before[elbow] > 5 * after[elbow]
    assert shown["candidates"] == [("joint_spring", "elbow_joint", 900.0), ("payload", None, 40.0)]
    assert {shown[k].shape for k in ("tau", "before", "after", "q", "dq")} == {(len(shown["t"]), ur5e.n)}


def test_an_effect_is_switched_off_in_the_corrected_arm_and_on_in_the_nominal_one(ur5e: Arm) -> None:
    truth = with_effect(ur5e, SPRING)
    logs = [recorded(truth, fourier_motion(ur5e, seed, seconds=8.0)) for seed in (1, 2)]
    shown = evidence.of_diagnosis(ur5e, truth, logs[0], found(), logs[1:])
    for curves in (shown, *shown["others"]):
        spring, payload = curves["switched"]
        assert (spring["effect"], spring["identified"], payload["effect"], payload["identified"]) == (
            "joint_spring",
            True,
            "payload",
            False,
        )
        np.testing.assert_allclose(spring["tau"], curves["before"])
        assert np.abs(payload["tau"] - curves["before"]).max() > 1.0
        assert spring["tau"].shape == payload["tau"].shape == curves["tau"].shape


def test_bad_data_is_not_drawn(ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, seconds=8.0))
    assert evidence.of_diagnosis(ur5e, ur5e, log, found("bad_data")) == {}
    check = validate(ur5e, [log], forward=False).checks[0]
    assert evidence.of_check(check)["log"] == check.log
