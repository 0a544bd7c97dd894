"""The calibrated arm holds every fitted value, and nominal values only for what was not fitted."""

from __future__ import annotations

import numpy as np

from calib.identification.calibrated import calibrated_arm
from calib.identification.consistency import PossibleArm
from calib.identification.model import TorqueModel
from calib.identification.prior import full_nominal
from sim.arm import ArmEffect, load_arm
from sim.effects import with_effect


def test_a_presliding_stiffness_that_the_fit_replaced_does_not_stay() -> None:
    arm = load_arm("servo6")
    joint = arm.joint_names[1]
    arm = with_effect(arm, ArmEffect("presliding_friction", joint, {"stiffness": 500.0}))
    model = TorqueModel.of_arm(arm)
    possible = PossibleArm(full_nominal(arm, model), model.nominal())
    narrow = calibrated_arm(arm, model, possible, np.zeros(model.p), ["log"])
    assert narrow.effect("presliding_friction", joint) is None
    wide = calibrated_arm(arm, model.with_slip_width(np.full(arm.n, 0.01)), possible, np.zeros(model.p), ["log"])
    found = wide.effect("presliding_friction", joint)
    assert found is not None
    assert found.parameters["stiffness"] != 500.0
