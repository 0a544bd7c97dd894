"""Oscillations and other torques outside the catalogue are reported as unexplained at their joint, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded, varied, without_offsets
from calib.claims.diagnosis_sentences import variable
from calib.diagnosis import additive_basis
from calib.diagnosis.additive_basis import SPOTS, hats
from calib.diagnosis.answer import Diagnosis
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import measured
from calib.diagnosis.tone import strongest
from sim.arm import Arm, load_arm
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import NOISE, Hidden, recording

PAN, WRIST = 0, 3


def asked(arm: Arm, hidden: Hidden) -> Diagnosis:
    logs = [recording(arm, seed, hidden) for seed in (1, 2, 3)]
    return diagnose(arm, logs[:2], logs[2:])


def unexplained_at(found: dict[str, Any], joint: str) -> list[str]:
    """What the structure at this joint depends on; asserts that nothing is named and no other joint has structure."""
    assert (found["verdict"], found["effects"]) == ("unexplained", [])
    assert [u["joint"] for u in found["unexplained"]] == [joint]
    return list(found["unexplained"][0]["depends_on"])


def pickup(frequency: float) -> Hidden:
    """A tone at a wrist, as large as its noise, with another phase in every recording."""

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        size = 1.5 * NOISE * np.abs(tau[:, WRIST]).max()
        out[:, WRIST] = size * np.sin(2 * np.pi * frequency * motion.t + 1e3 * motion.q[0, PAN])
        return out

    return hidden


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [2.83, 6.17])
def test_an_oscillation_in_time_alone_is_reported_with_its_frequency(ur10e: Arm, frequency: float) -> None:
    found = asked(ur10e, pickup(frequency)).answer
    (depends,) = unexplained_at(found, "wrist_1_joint")
    kind, _, value = depends.partition(":")
    assert kind == "tone"
    assert float(value.removesuffix(" Hz")) == pytest.approx(frequency, abs=0.04)
    assert variable(depends) == f"a constant oscillation of {value}"


@pytest.mark.parametrize(("frequency", "inertia"), [(0.8, 4.0), pytest.param(0.55, 2.0, marks=pytest.mark.slow)])
def test_a_mass_that_swings_behind_a_joint_is_reported_as_a_resonance(ur10e: Arm, frequency: float, inertia: float) -> None:
    def slosh(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out, w, dt = np.zeros_like(tau), 2 * np.pi * frequency, motion.t[1] - motion.t[0]
        x = v = 0.0
        for k, push in enumerate(motion.ddq[:, PAN]):  # semi-implicit Euler
            v += dt * (-push - 0.16 * w * v - w * w * x)
            x += dt * v
            out[k, PAN] = inertia * w * w * x
        return out

    found = asked(ur10e, slosh).answer
    assert "resonance:shoulder_pan_joint" in unexplained_at(found, "shoulder_pan_joint")


@pytest.mark.slow
@pytest.mark.parametrize(("width", "level"), [(0.15, 8.0), (0.28, 10.0)])
def test_a_dress_pack_that_drags_after_reversals_is_reported_as_hysteresis(ur10e: Arm, width: float, level: float) -> None:
    """A play operator, which reaches its level at once, unlike Dahl's law."""

    def hose(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out, held = np.zeros_like(tau), motion.q[0, PAN]
        for k, q in enumerate(motion.q[:, PAN]):
            held = np.clip(held, q - width, q + width)
            out[k, PAN] = level * (q - held) / width
        return out

    found = asked(ur10e, hose).answer
    assert "hysteresis:shoulder_pan_joint" in unexplained_at(found, "shoulder_pan_joint")
    assert variable("hysteresis:shoulder_pan_joint") == "the travel since a reversal of shoulder_pan_joint"


@pytest.mark.slow
def test_a_damaged_tooth_is_reported_as_friction_at_one_angle(ur10e: Arm) -> None:
    def dent(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out, q, dq = np.zeros_like(tau), motion.q[:, WRIST], motion.dq[:, WRIST]
        size = 3.0 * NOISE * np.abs(tau[:, WRIST]).max()
        out[:, WRIST] = size * np.sign(dq) / (1.0 + ((q + 1.0) / 0.12) ** 4)
        return out

    found = asked(ur10e, dent).answer
    assert "spot:wrist_1_joint" in unexplained_at(found, "wrist_1_joint")
    assert variable("spot:wrist_1_joint") == "friction at one angle of wrist_1_joint"


def test_a_shaft_that_turns_many_times_passes_the_same_angles() -> None:
    turns = 2 * np.pi * 1e5
    q = np.array([[0.4], [0.4 + turns], [0.4 - turns]])
    found = hats(cast(LogModel, SimpleNamespace(link=SimpleNamespace(q=q))), 0)
    assert found.shape == (3, SPOTS)
    assert found.sum(axis=1) == pytest.approx(1.0)
    assert found == pytest.approx(np.tile(found[0], (3, 1)), abs=1e-6)


def creeping(seconds: float, stiffness: float) -> Hidden:
    """A cable at the wrist whose pull relaxes."""

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out, dt, crept = np.zeros_like(tau), motion.t[1] - motion.t[0], motion.q[0, WRIST]
        for k, q in enumerate(motion.q[:, WRIST]):
            crept += dt * (q - crept) / seconds
            out[k, WRIST] = stiffness * (q - crept)
        return out

    return hidden


def dragging(waves: float, most: float) -> Hidden:
    """An eccentric gear at the wrist."""

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        out[:, WRIST] = most * motion.dq[:, WRIST] * np.sin(waves * motion.q[:, WRIST] + 0.6)
        return out

    return hidden


@pytest.mark.parametrize(
    ("hidden", "imitated", "words"),
    [
        pytest.param(creeping(5.0, 4.0), "joint spring", "relaxes within seconds", marks=pytest.mark.slow),
        pytest.param(dragging(2.0, 2.0), "encoder eccentricity", "varies along the angle", marks=pytest.mark.slow),
    ],
)
def test_what_imitates_an_effect_is_not_given_its_name(ur10e: Arm, hidden: Hidden, imitated: str, words: str) -> None:
    found = asked(ur10e, hidden).answer
    unexplained_at(found, "wrist_1_joint")
    assert any(x.startswith(imitated) and words in x for x in found["refused"])


@pytest.mark.slow
def test_a_strong_effect_is_not_taken_for_what_imitates_it(ur10e: Arm) -> None:
    """Robust weights remove most of what a strong spring gains, but nothing of an imitator's linear gain."""

    def spring(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        out[:, WRIST] = 12.0 * (motion.q[:, WRIST] + 1.4)
        return out

    found = asked(ur10e, spring).answer
    (effect,) = found["effects"]
    assert (effect["effect"], effect["joint"]) == ("joint_spring", "wrist_1_joint")
    assert effect["parameters"]["stiffness"]["value"] == pytest.approx(12.0, rel=0.02)


@pytest.mark.parametrize("gap", [0.0, 0.15, 0.45])
def test_a_tone_is_found_on_both_sides_of_a_gap(ur10e: Arm, gap: float) -> None:
    frequency, models, residuals = 3.3, [], []
    for seed in (1, 2):
        m = LogModel(measured(recording(ur10e, seed, seconds=40.0), ur10e), Hypothesis.nominal(ur10e))
        t = m.link.t + np.where(np.arange(len(m.link.t)) > len(m.link.t) // 2, gap, 0.0)
        late = replace(m.link, t=t)
        models.append(SimpleNamespace(measurement=m.measurement, link=late))
        noise = 0.3 * np.random.default_rng(seed).standard_normal(len(m.measurement.row_samples))
        residuals.append(noise + 0.15 * np.sin(2 * np.pi * frequency * t[m.measurement.row_samples] + seed))
    found = strongest(cast("list[LogModel]", models), residuals, 0, 2)
    assert found is not None
    assert found.frequency == pytest.approx(frequency, abs=0.03)
    assert min(found.gains) > 8.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 21, 51])
def test_noise_in_many_columns_is_no_structure_without_a_held_out_recording(seed: int) -> None:
    """Hats over a turn fit noise in proportion to their number: these three recordings once showed friction at one angle."""
    arm = load_arm("servo6")
    truth = without_offsets(varied(arm, seed, 0.01))
    logs = [recorded(truth, fourier_motion(arm, seed + k, 20.0, 200.0), seed + k, memory=0.0) for k in (0, 1)]
    found = diagnose(arm, logs).answer
    assert (found["verdict"], found["unexplained"]) == ("no_missing_effect", [])


def test_no_filtered_part_remembers_what_was_before_a_gap(ur10e: Arm) -> None:
    log = recording(ur10e, 1)
    half = len(log) // 2
    late = log.t + np.where(np.arange(len(log)) >= half, 20.0, 0.0)
    other = log.q.copy()
    other[:half] = log.q[0] + 0.5 * (log.q[:half] - log.q[0])
    models = [LogModel(measured(replace(log, t=late, q=q), ur10e), Hypothesis.nominal(ur10e)) for q in (log.q, other)]
    (first, second), (_, third) = (m.measurement.starts[1:] for m in models)
    assert second == third
    for part in (additive_basis._resonances, lambda m, j: additive_basis._own(m, j)[f"memory:{ur10e.joint_names[j]}"][0]):
        one, two = (np.asarray(part(m, PAN)) for m in models)
        assert np.abs(one[:first] - two[:first]).max() > 1e-3
        np.testing.assert_allclose(one[first:], two[first:], atol=1e-9)
