"""A spring at a joint or a coupled transmission is no wrong reading; a wrong reading of such an arm is still one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded
from benchmarks.wrong_data import arm, family, within
from calib.gate import gate
from logs.log import Log
from sim.arm import ArmEffect
from sim.effects import with_effect

WRIST = "wrist_3_joint"


def sprung(name: str, motion: int, stiffness: float) -> Log:
    """A recording of an arm with a spring at its last joint."""
    of = arm(name)
    truth = with_effect(of, ArmEffect("joint_spring", WRIST, {"stiffness": stiffness, "rest_angle": 0.0}))
    return recorded(truth, within(of, fourier_motion(of, motion, 20.0, 100.0)), 3)


@pytest.mark.parametrize(("name", "motion", "stiffness"), [("ur10e", 32, 30.0), ("ur10e", 31, 30.0), ("servo6", 32, 8.0)])
def test_a_spring_is_neither_another_sign_nor_another_unit(name: str, motion: int, stiffness: float) -> None:
    """It pulls back where inertia pushes on: against the masses alone its torque has the wrong sign, or 11 times the size."""
    assert gate(arm(name), [sprung(name, motion, stiffness)], family=family).refusal is None


def test_a_spring_hides_no_wrong_unit() -> None:
    log = sprung("ur10e", 32, 30.0)
    tau = log.tau.copy()
    tau[:, -1] *= 1000.0
    refusal = gate(arm("ur10e"), [replace(log, tau=tau)], family=family).refusal
    assert refusal is not None
    assert WRIST in refusal


def test_a_spring_hides_no_exchanged_columns() -> None:
    log = sprung("ur10e", 32, 30.0)
    exchanged = log.tau[:, np.array([0, 1, 2, 4, 3, 5])]
    assert gate(arm("ur10e"), [replace(log, tau=exchanged)], family=family).refusal is not None


def test_torques_that_are_missing_at_the_joint_in_question_are_no_crash() -> None:
    """A reversed joint shows at the others too, so that it is asked about although its own torque is not known throughout."""
    of = arm("ur10e")
    log = recorded(of, within(of, fourier_motion(of, 31, 20.0, 100.0)), 3)
    q, dq, tau, current = log.q.copy(), log.dq.copy(), log.tau.copy(), np.full_like(log.current, np.nan)
    q[:, 2] *= -1
    dq[:, 2] *= -1
    tau[100:1500, 2] = np.nan
    refusal = gate(of, [replace(log, q=q, dq=dq, tau=tau, current=current)], family=family).refusal
    assert refusal is not None
    assert "elbow_joint" in refusal
