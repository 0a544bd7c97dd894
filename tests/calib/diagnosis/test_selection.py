"""Candidates whose linear gain misleads: one is not admissible, one has a torque that is not proportional to its parameter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.diagnosis import selection
from calib.diagnosis.candidates import in_place_of
from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.pairs import paired
from calib.diagnosis.scoring import Scored
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import recording

JOINT = "elbow_joint"
Started = tuple[list[Measurement], Fit]


def started(arm: Arm, hidden: ArmEffect) -> Started:
    def added(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        return predict(with_effect(arm, hidden), motion) - predict(arm, motion)

    measurements = warmed([measured(recording(arm, seed, added), arm) for seed in (1, 2)])
    return measurements, selection.started(measurements, Hypothesis.nominal(arm))


@pytest.fixture(scope="module")
def sprung(ur10e: Arm) -> Started:
    return started(ur10e, ArmEffect("joint_spring", JOINT, {"stiffness": 12.0, "rest_angle": 0.4}))


def test_a_weaker_promise_is_tried_where_the_strongest_is_not_admissible(
    sprung: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    measurements, baseline = sprung
    right = ArmEffect("joint_spring", JOINT, {"stiffness": 10.0, "rest_angle": 0.3})
    refused = ArmEffect("torque_gain", JOINT, {"gain": 1.1})
    monkeypatch.setattr(selection, "admissible", lambda f: all(e.effect != refused.effect for e in f.accepted))
    found = selection.best_next(measurements, baseline, [Scored(refused, 1000.0, 1), Scored(right, 100.0, 2)])
    assert found is not None
    assert [e.effect for e in found.accepted] == [right.effect]


def test_a_weaker_promise_is_tried_where_the_strongest_fits_worse(sprung: Started) -> None:
    measurements, baseline = sprung
    right = ArmEffect("joint_spring", JOINT, {"stiffness": 10.0, "rest_angle": 0.3})
    empty = ArmEffect("asymmetric_friction", "wrist_2_joint", {"half_difference": 0.1})
    found = selection.best_next(measurements, baseline, [Scored(empty, 1000.0, 1), Scored(right, 100.0, 2)])
    assert found is not None
    assert [e.effect for e in found.accepted] == [right.effect]
    assert selection.best_next(measurements, baseline, [Scored(empty, 1000.0, 1)]) is None


def test_an_effect_whose_promise_is_too_large_is_begun_again_from_less(
    sprung: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example a time delay on the real UR10e, whose linear fit gave 10 ms."""
    measurements, baseline = sprung
    tried = []

    def added(measurements: list[Measurement], f: Fit, s: Scored) -> Fit:
        tried.append(s.effect.parameters["delay"])
        return replace(f, objective=f.objective + (50.0 if tried[-1] > 0.004 else -50.0))

    monkeypatch.setattr(selection, "_added", added)
    found = selection.add(measurements, baseline, Scored(ArmEffect("time_delay", None, {"delay": 0.01}), 1000.0, 1))
    assert found.objective == baseline.objective - 50.0
    assert tried == pytest.approx([0.01, 0.005, 0.002])


def test_the_search_ends_where_a_joint_is_beyond_the_catalogue(ur10e: Arm) -> None:
    """A load that swings at 1 Hz behind the elbow: three effects there leave most of it."""

    def strange(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        dt, w = float(np.median(np.diff(motion.t))), 2 * np.pi
        x = lfilter([0.0, -(dt**2)], [1.0, -2.0 + 0.1 * w * dt, 1.0 - 0.1 * w * dt + (w * dt) ** 2], motion.ddq[:, 2])
        out = np.zeros_like(tau)
        out[:, 2] = 80.0 * x / np.std(x)
        return out

    measurements = warmed([measured(recording(ur10e, seed, strange), ur10e) for seed in (1, 2)])
    found = selection.search(measurements, Hypothesis.nominal(ur10e))
    assert found.hopeless
    assert len(found.best.accepted) < selection.MOST_EFFECTS
    assert paired(measurements, found) is found


def test_a_width_begun_too_narrow_to_matter_is_found_from_a_larger_one(ur10e: Arm) -> None:
    """Bristles narrower than in every bearing change nothing, so the fit has no gradient."""
    hidden = ArmEffect("presliding_friction", JOINT, {"stiffness": 3000.0})
    measurements, baseline = started(ur10e, hidden)
    width = baseline.hypothesis.width[ur10e.joint_index(JOINT)]
    level = next(e for e in ur10e.effects if (e.effect, e.joint) == ("coulomb_friction", JOINT)).parameters["coulomb"]
    narrow = ArmEffect(hidden.effect, JOINT, {"stiffness": 1.5 * level / width})

    def brought(item: ArmEffect) -> tuple[float, float]:
        found = selection.add(measurements, baseline, Scored(item, 100.0, 1))
        return baseline.objective - found.objective, found.accepted[0].parameters["stiffness"]

    (most, there), (found, stiffness) = brought(hidden), brought(narrow)
    assert most > 50.0
    assert found == pytest.approx(most, rel=0.1)
    assert stiffness == pytest.approx(there, rel=0.1)


@pytest.mark.parametrize(
    ("effect", "joint", "may"),
    [
        ("coulomb_friction", "elbow_joint", True),
        ("coulomb_friction", "wrist_1_joint", False),
        ("transmission_coupling", "wrist_2_joint", True),  # a torque of two joints
        ("encoder_offset", "wrist_2_joint", True),
        ("payload", None, True),
    ],
)
def test_only_what_changes_a_torque_of_its_joint_stands_for_an_effect(
    ur10e: Arm, effect: str, joint: str | None, may: bool
) -> None:
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 12.0, "rest_angle": 0.4})
    wanted = in_place_of(spring, ur10e.joint_names)
    assert bool(wanted(effect_named(effect), None if joint is None else ur10e.joint_index(joint))) == may
    assert in_place_of(ArmEffect("payload", None, {}), ur10e.joint_names)(effect_named("coulomb_friction"), 0)
