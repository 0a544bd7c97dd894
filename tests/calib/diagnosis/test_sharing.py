"""A model that borrows parts equals the model made alone, and the search does not retry an effect that cannot help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis import selection
from calib.diagnosis.candidates import Key
from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.scoring import Bank, Scored
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from tests.calib.diagnosis.conftest import at, recording

HEAVIER = ArmEffect("link_inertia", "elbow_joint", {"mass": 14.0, "com_x": -0.2, "com_y": 0.0, "com_z": 0.05})
TILT = ArmEffect("base_tilt", None, {"roll": 0.02, "pitch": -0.01})
FRICTION = ArmEffect("coulomb_friction", "wrist_1_joint", {"coulomb": 5.0})
SPRING = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.4})
RIPPLE = ArmEffect("torque_ripple", "elbow_joint", {"amplitude": 0.5, "cycles": 2.0, "phase": 0.0})
OFFSET = ArmEffect("torque_offset", "elbow_joint", {"offset": 0.5})
ELBOW = 2


@pytest.mark.parametrize(
    "changes", [(), (HEAVIER,), (TILT,), (FRICTION,), (HEAVIER, TILT)], ids=["none", "link", "tilt", "friction", "both"]
)
def test_a_model_that_borrows_is_the_one_made_alone(ur10e: Arm, changes: tuple[ArmEffect, ...]) -> None:
    lender, borrowed, alone = _models(ur10e, changes)
    np.testing.assert_array_equal(borrowed.residual, alone.residual)
    np.testing.assert_array_equal(borrowed.tau_hat, alone.tau_hat)
    for j in range(ur10e.n):
        np.testing.assert_array_equal(borrowed.nuisance(j), alone.nuisance(j))
    assert np.array_equal(borrowed.residual, lender.residual) == (not changes)


def test_another_mass_leaves_the_joints_behind_it_shared(ur10e: Arm) -> None:
    lender, borrowed, _ = _models(ur10e, (HEAVIER,))
    assert borrowed.regressor_rows is lender.regressor_rows
    shared = [a is b for a, b in zip(borrowed.side.joints, lender.side.joints, strict=True)]
    assert shared == [False, False, False, True, True, True]


def test_gravity_from_another_side_shares_nothing(ur10e: Arm) -> None:
    lender, borrowed, _ = _models(ur10e, (TILT,))
    assert borrowed.regressor_rows is not lender.regressor_rows
    assert not any(a is b for a, b in zip(borrowed.side.joints, lender.side.joints, strict=True))


def test_what_fits_worse_than_nothing_is_not_asked_again(ur10e: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = warmed([measured(recording(ur10e, 1, at(ELBOW, lambda q, dq: 12.0 * (q - 0.4))), ur10e)])
    f = selection.started(fitted, Hypothesis.nominal(ur10e))
    for item in (SPRING, RIPPLE):
        f = selection.add(fitted, f, Scored(item, 100.0, 2))
    near = [Scored(item, 1e6, 2) for item in (FRICTION, OFFSET)]
    asked: list[str] = []

    def worse(measurements: Sequence[Measurement], rest: Fit, item: Scored) -> Fit:
        asked.append(item.effect.effect)
        return replace(rest, objective=rest.objective + (1.0 if item is near[0] else -1.0))

    monkeypatch.setattr(selection, "beside", lambda *_: near)
    monkeypatch.setattr(selection, "add", worse)
    hopeless = set[Key]()
    for _ in range(2):
        assert selection.exchanged(fitted, f, Bank(), hopeless) is f
    assert asked == [FRICTION.effect, OFFSET.effect, OFFSET.effect]
    assert hopeless == {(FRICTION.effect, FRICTION.joint)}


def _models(arm: Arm, changes: tuple[ArmEffect, ...]) -> tuple[LogModel, LogModel, LogModel]:
    """A nominal model, a changed model that borrows from it, and the same changed model made alone."""
    [m] = warmed([measured(recording(arm, 1), arm)])
    nominal = Hypothesis.nominal(arm)
    lender = LogModel(m, nominal)
    changed = nominal.with_effects(changes)
    return lender, LogModel(m, changed, like=lender), LogModel(m, changed)
