"""A spring, a coupled transmission or a pull at the tool is not reported as a wrong reading and does not hide one."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import HOME, fourier_motion, recorded
from benchmarks.wrong_data import arm, family, within
from calib.gate import gate
from logs.log import Log
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.trajectory import Trajectory

WRIST = "wrist_3_joint"


def sprung(name: str, motion: int, stiffness: float) -> Log:
    """A recording of an arm with a spring at its last joint."""
    return beside(name, motion, ArmEffect("joint_spring", WRIST, {"stiffness": stiffness, "rest_angle": 0.0}))


def beside(name: str, motion: int, effect: ArmEffect) -> Log:
    """A recording of an arm with an effect."""
    of = arm(name)
    return recorded(with_effect(of, effect), within(of, fourier_motion(of, motion, 20.0, 100.0)), 3)


def small(of: Arm, motion: int) -> Trajectory:
    """A motion of at most 0.9 rad to either side."""
    wide = within(of, fourier_motion(of, motion, 20.0, 100.0))
    way = wide.q - wide.q.mean(axis=0)
    by = np.minimum(1.0, 0.9 / np.abs(way).max(axis=0))
    return Trajectory(wide.t, HOME + by * way, by * wide.dq, by * wide.ddq)


PULLS = [
    ArmEffect("tool_force", None, {"force_x": x, "force_y": y, "force_z": z})
    for x, y, z in ((7.0, -19.0, -15.0), (19.0, -23.0, 4.0))
]
LOAD = ArmEffect("payload", None, {"mass": 3.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05})


@pytest.mark.parametrize(("motion", "effect"), [*itertools.product((31, 34), PULLS), (32, LOAD)])
def test_what_is_mounted_is_neither_another_unit_nor_another_arm(motion: int, effect: ArmEffect) -> None:
    """25 to 30 N at the flange of a 4 kg arm is most of its joint load."""
    of = arm("servo6")
    log = recorded(with_effect(of, effect), small(of, motion), 3)
    assert gate(of, [log], family=family).refusal is None
    assert gate(of, [replace(log, tau=log.tau * 1000.0)], family=family).refusal is not None


def test_what_is_mounted_is_found_where_torques_of_a_joint_are_missing() -> None:
    of = arm("servo6")
    log = recorded(with_effect(of, PULLS[0]), small(of, 34), 3)
    tau = log.tau.copy()
    tau[100:900, 1] = np.nan
    assert gate(of, [replace(log, tau=tau)], family=family).refusal is None


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


@pytest.mark.parametrize(
    "effect",
    [
        ArmEffect("joint_spring", "shoulder_lift_joint", {"stiffness": 25.0, "rest_angle": 0.3}),
        ArmEffect("joint_spring", "elbow_joint", {"stiffness": 15.0, "rest_angle": 0.0}),
        PULLS[1],
    ],
    ids=["lift", "elbow", "pull"],
)
def test_what_the_file_states_is_part_of_the_model(effect: ArmEffect) -> None:
    """At a joint of a 4 kg arm, 25 N m/rad exceeds gravity."""
    of = with_effect(arm("servo6"), effect)
    log = recorded(of, within(of, fourier_motion(of, 31, 20.0, 100.0)), 3)
    assert gate(of, [log], family=family).refusal is None
    reversed_ = log.tau * np.array([1, -1, 1, 1, 1, 1])
    refusal = gate(of, [replace(log, tau=reversed_)], family=family).refusal
    assert refusal is not None
    assert "shoulder_lift_joint" in refusal.split("Other causes")[0]


def test_a_spring_hides_no_exchanged_columns() -> None:
    log = sprung("ur10e", 32, 30.0)
    exchanged = log.tau[:, np.array([0, 1, 2, 4, 3, 5])]
    assert gate(arm("ur10e"), [replace(log, tau=exchanged)], family=family).refusal is not None


def test_torques_that_are_missing_at_the_joint_in_question_are_no_crash() -> None:
    """A reversed joint also affects the others, so it is examined although part of its own torque is missing."""
    of = arm("ur10e")
    log = recorded(of, within(of, fourier_motion(of, 31, 20.0, 100.0)), 3)
    q, dq, tau, current = log.q.copy(), log.dq.copy(), log.tau.copy(), np.full_like(log.current, np.nan)
    q[:, 2] *= -1
    dq[:, 2] *= -1
    tau[100:1500, 2] = np.nan
    refusal = gate(of, [replace(log, q=q, dq=dq, tau=tau, current=current)], family=family).refusal
    assert refusal is not None
    assert "elbow_joint" in refusal
