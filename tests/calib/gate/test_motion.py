"""Speed against position: columns, signs and units are distinguished; scaled speeds and laws do not count as exchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded
from benchmarks.wrong_data import within
from calib.excitation.sweeps import friction_sweeps
from calib.gate import gate
from calib.gate.correction import Correction
from calib.gate.motion import speed
from calib.gate.search import GainStep, doubtful
from calib.gate.signals import signals
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import effect_named, with_effect
from tests.calib.diagnosis.conftest import at, recording


@pytest.fixture(scope="module")
def servo6() -> Arm:
    return load_arm("servo6")


def log_of(arm: Arm, seed: int, seconds: float = 12.0) -> Log:
    return recorded(arm, within(arm, fourier_motion(arm, seed, seconds, 100.0)), seed)


def words(arm: Arm, log: Log) -> list[str]:
    """Corrections that the check of speed against position offers, best first; empty if it passes."""
    check, _ = speed(arm, signals([log], [log.tau]), massive=True)
    assert check.ok == (not check.causes)
    return [c.word(arm.joint_names) for cause in check.causes for c in cause.corrections]


def test_speeds_of_two_joints_in_each_others_columns(servo6: Arm) -> None:
    log = log_of(servo6, 41)
    dq = log.dq[:, [0, 1, 3, 2, 4, 5]]
    found = words(servo6, replace(log, dq=dq))
    both = f"{servo6.joint_names[2]},{servo6.joint_names[3]}"
    assert {f"swap:dq:{both}", f"swap:q:{both}"} <= set(found)


@pytest.mark.parametrize("factors", [(3.0, 3.0), (0.35, 3.0), (4.0, 0.3)])
def test_a_speed_that_is_scaled_is_in_its_own_column(servo6: Arm, factors: tuple[float, float]) -> None:
    """Two joints move alike, so the speed of each also matches the position of the other. Nothing is exchanged."""
    log = log_of(servo6, 42)
    q, dq = log.q.copy(), log.dq.copy()
    q[:, 3], dq[:, 3] = 0.2 + 0.5 * (q[:, 2] - 1.0), 0.5 * dq[:, 2]
    dq[:, [2, 3]] *= factors
    found = words(servo6, replace(log, q=q, dq=dq))
    assert not [word for word in found if word.startswith("swap")]


def test_units_and_signs_of_a_speed(servo6: Arm) -> None:
    log = log_of(servo6, 43)
    assert words(servo6, log) == []
    assert words(servo6, replace(log, dq=np.degrees(log.dq)))[0] == "dq=deg/s"
    turned = log.dq * np.array([1, 1, 1, -1, 1, 1])
    assert set(words(servo6, replace(log, dq=turned))) == {f"sign:{part}:{servo6.joint_names[3]}" for part in ("q", "dq")}


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 3.0])
def test_a_wrong_sample_rate_is_no_gear_ratio(servo6: Arm, factor: float) -> None:
    """All joints show the same ratio, which no single joint's gear explains."""
    log = log_of(servo6, 47)
    found = gate(servo6, [replace(log, t=log.t * factor)])
    assert found.refusal is not None
    assert "the sample rate is wrong" in found.causes[0].sentence, found.refusal
    assert not any(c.kind == "scale" for c in found.causes[0].corrections)


def test_a_ratio_that_all_speeds_share_is_accepted_where_masses_are_unknown(servo6: Arm) -> None:
    """Published recordings of a robot hold three times the speed at every joint; without masses, nothing shows what is wrong."""
    log = log_of(servo6, 47)
    tripled = replace(log, dq=3 * log.dq)
    check, _ = speed(servo6, signals([tripled], [tripled.tau]), massive=False)
    assert check.ok
    assert "the sample rate may be wrong" in check.detail
    check, _ = speed(servo6, signals([tripled], [tripled.tau]), massive=True)
    assert check.ok, "the arm's masses fit the motion as it was recorded"


def test_speeds_of_all_motors_before_their_gears(servo6: Arm) -> None:
    """The same ratio at all joints as with a wrong rate, but the arm's model fits the motion as it was recorded."""
    log = log_of(servo6, 48)
    found = words(servo6, replace(log, dq=100 * log.dq))
    assert found
    assert all(word.startswith("scale:dq") for word in found)


def with_laws(arm: Arm) -> Arm:
    """Fitted friction laws with memory, with the sign that drives with friction compensation report."""
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters}
    for j, slip in {3: -3.0, 4: -6.0, 5: 6.0}.items():
        arm = with_effect(arm, ArmEffect("friction_law", arm.joint_names[j], law | {"slip_1e-1": slip}))
    return arm


def test_laws_of_the_arm_are_taken_away_from_several_logs(servo6: Arm) -> None:
    fitted = with_laws(servo6)
    logs = [log_of(fitted, seed, 8.0) for seed in (44, 45, 46)]
    found = gate(fitted, logs)
    assert found.refusal is None, found.refusal
    assert "wrong sign" in (gate(servo6, logs).refusal or ""), "without its laws the arm would not explain these signs"
    wrong = [replace(log, tau=log.tau * np.array([1, -1, 1, 1, 1, 1])) for log in logs]
    assert f"sign:tau:{servo6.joint_names[1]}" in (gate(fitted, wrong).refusal or "")


@pytest.mark.parametrize(("gain", "joint", "expected"), [(0.5, 0, True), (2.5, 0, False), (0.5, 1, False)])
def test_a_small_gain_at_a_joint_whose_law_was_fitted_names_no_column(gain: float, joint: int, expected: bool) -> None:
    arm = load_arm("servo6")
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters}
    arm = with_effect(arm, ArmEffect("friction_law", arm.joint_names[0], law | {"slip_1e-1": 1.0}))
    assert doubtful(arm, GainStep(Correction("swap", "all", (joint, 5)), gain)) == expected


def test_a_spring_of_the_one_joint_that_moves_exchanges_no_columns_of_those_that_stand() -> None:
    """Another posture would give the torque of the moving joint a similar shape."""
    arm, spring = load_arm("ur10e"), at(2, lambda q, dq: 12.0 * (q - 0.4))
    dry = [e.parameters["coulomb"] for name in arm.joint_names if (e := arm.effect("coulomb_friction", name))]
    stuck = np.where(np.arange(arm.n) == 2, 0.0, 0.8 * np.array(dry))
    sweep = recording(arm, 12, lambda motion, tau: spring(motion, tau) + stuck, only=2)
    assert gate(arm, [sweep]).refusal is None


@pytest.mark.parametrize("name", ["ur5e", "servo6"])
def test_joints_that_move_one_after_the_other_are_not_taken_for_exchanged(name: str) -> None:
    """While one joint moves, the torque of the others is noise: that it is small must not count for a wrong reading."""
    arm = load_arm(name)
    home = np.array([0.0, -1.2, 1.3, -1.4, -1.2, 0.3])
    speeds = np.outer(0.6 * arm.dq_max, [0.05, 0.1, 0.2, 0.4, 0.8])
    sweeps = friction_sweeps(arm, home, low=home - 1, high=home + 1, speeds=speeds, cruise=1.2, rate=200.0)
    log = recorded(arm, sweeps, 1)
    assert gate(arm, [log]).refusal is None
    crossed = np.array([5, 1, 2, 3, 4, 0])
    refusal = gate(arm, [replace(log, q=log.q[:, crossed], dq=log.dq[:, crossed])]).refusal
    assert refusal is not None
    assert "the motion columns of shoulder_pan_joint and wrist_3_joint are swapped" in refusal
