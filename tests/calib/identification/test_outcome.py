"""The curves on the page of an identification agree with its tables."""

from __future__ import annotations

import numpy as np

from benchmarks.known_truth import fourier_motion, recorded
from calib.identification.identify import identify
from calib.identification.outcome import evidence
from sim.arm import ArmEffect, load_arm
from sim.effects import effect_named, with_effect

JOINT = 2


def test_the_curves_hold_the_torque_of_the_friction_laws() -> None:
    arm = load_arm("servo6")
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {"slip_3e-2": 4.0}
    truth = with_effect(arm, ArmEffect("friction_law", arm.joint_names[JOINT], law))
    logs = [recorded(truth, fourier_motion(arm, 60 + k, 10.0, 100.0), k) for k in range(3)]
    found = identify(arm, logs[:2], logs[2:])
    assert arm.joint_names[JOINT] in {e.joint for e in found.laws}
    drawn, table = evidence(found), found.result.holdout
    assert table is not None
    left = np.sqrt(np.mean((drawn["tau"] - drawn["after"])[:, JOINT] ** 2))
    assert left < 1.3 * table.after[JOINT]
    assert left < 0.5 * np.sqrt(np.mean((drawn["tau"] - drawn["before"])[:, JOINT] ** 2))
