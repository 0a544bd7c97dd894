"""A recording in which one joint moves alone: nothing is said of those that stand, and nothing is written for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.diagnosis.diagnose import diagnose
from sim.arm import ArmEffect, load_arm
from sim.effects import with_effect
from tests.calib.conftest import fourier_motion, recorded


def test_one_joint_that_moves_alone() -> None:
    arm = load_arm("servo6")
    moved = fourier_motion(arm, 81, 8.0, 100.0)
    only = np.where(np.arange(arm.n) == 1, 1.0, 0.0)
    motion = replace(moved, q=moved.q[0] + only * (moved.q - moved.q[0]), dq=only * moved.dq, ddq=only * moved.ddq)
    truth = with_effect(arm, ArmEffect("viscous_friction", arm.joint_names[1], {"viscous": 3.0}))
    log = recorded(truth, motion, 1, memory=0.0)
    answer = diagnose(arm, [log]).answer
    assert answer["verdict"] != "bad_data"
    assert {e["joint"] for e in answer["effects"]} <= {arm.joint_names[1], None}
    assert {law["joint"] for law in answer["laws"]} <= {arm.joint_names[1]}
