"""A fit as an arm folder holds it: joints that the given arm predicts better keep its values."""

from __future__ import annotations

import numpy as np
import pytest

from calib.diagnosis.corrected import ArmChange
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.written_arm import WrittenArm, own_kept, simplest_first
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from tests.calib.diagnosis.conftest import recording

ELBOW, WRIST = "elbow_joint", "wrist_1_joint"


@pytest.fixture(scope="module")
def shown(ur10e: Arm) -> list[Measurement]:
    return warmed([measured(recording(ur10e, 3), ur10e)])


def moved(**viscous: float) -> ArmChange:
    """A change of viscous friction at the given joints."""
    return ArmChange({}, tuple(ArmEffect("viscous_friction", joint, {"viscous": value}) for joint, value in viscous.items()))


def test_the_joint_that_a_refit_predicts_worse_keeps_its_own_friction(ur10e: Arm, shown: list[Measurement]) -> None:
    """Viscous friction changes at two joints. Only the joint that is predicted worse keeps its own."""
    own = ur10e.effect("viscous_friction", WRIST)
    assert own is not None
    kept = WrittenArm.of(ArmChange({}, ()), (), ur10e, shown)
    change = moved(**{ELBOW: 80.0, WRIST: own.parameters["viscous"]})
    (way,) = own_kept(WrittenArm.of(change, (), ur10e, shown), kept, ur10e, shown)
    assert [e.joint for e in way.change.effects] == [WRIST]
    assert way.rms == pytest.approx(kept.rms)


def test_a_refit_that_predicts_no_joint_worse_is_no_other_way(ur10e: Arm, shown: list[Measurement]) -> None:
    kept = WrittenArm.of(ArmChange({}, ()), (), ur10e, shown)
    assert own_kept(kept, kept, ur10e, shown) == []
    assert np.all(kept.rms > 0)


def test_of_equally_good_variants_the_one_that_changes_least_comes_first() -> None:
    """Two joints; errors within 1% in the geometric mean are equal."""
    rows = np.ones((50, 2), dtype=bool)
    names, refit, better = (
        WrittenArm(ArmChange({}, ()), (), np.full((50, 2), 1.0) * sizes, rows, rows)
        for sizes in ([1.006, 1.006], [0.98, 1.02], [0.9, 1.0])
    )
    assert simplest_first([names, refit, better]) == [better, names, refit]
    assert simplest_first([refit, names]) == [refit, names]
