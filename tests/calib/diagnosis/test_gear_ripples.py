"""Gear ripple is found and fitted before the search for effects, and is not itself a named effect."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion
from calib.diagnosis.calibration import calibration
from calib.diagnosis.corrected import correction
from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.nuisance import Ripple
from calib.diagnosis.scoring import scored
from calib.diagnosis.selection import started
from calib.measurement import ripple_cycles
from sim.arm import Arm
from sim.effects import with_effect
from sim.effects.gear_ripple import FEWEST
from sim.effects.torque_ripple import CYCLES as CANDIDATES
from sim.prediction import predict
from tests.calib.diagnosis.conftest import at, recording

WRIST, CYCLES, AMPLITUDE = 4, 61.3, 0.5


def fitted(arm: Arm, amplitude: float) -> Fit:
    hidden = at(WRIST, lambda q, dq: amplitude * np.sin(CYCLES * q + 0.7))
    return started(warmed([measured(recording(arm, seed, hidden), arm) for seed in (1, 2)]), Hypothesis.nominal(arm))


@pytest.fixture(scope="module")
def rippling(ur10e: Arm) -> Fit:
    return fitted(ur10e, AMPLITUDE)


def test_a_ripple_is_found_with_its_cycles_and_size(ur10e: Arm, rippling: Fit) -> None:
    f = rippling
    found = {j: ripple for j, ripple in enumerate(f.hypothesis.ripples) if ripple is not None}
    assert set(found) == {WRIST}
    ripple, names = found[WRIST], f.models[0].names
    sine, cosine = (ripple.size * f.solved.theta[names.index(f"ripple_{of}_{WRIST + 1}")] for of in ("sin", "cos"))
    assert ripple.cycles == pytest.approx(CYCLES, abs=0.3)
    assert np.hypot(sine, cosine) == pytest.approx(AMPLITUDE, rel=0.15)
    # no effect explains a ripple that is already fitted
    assert max(s.gain for s in scored(f, set()) if s.effect.joint == ur10e.joint_names[WRIST]) < 30


def test_no_ripple_is_found_where_there_is_none(ur10e: Arm) -> None:
    assert fitted(ur10e, 0.0).hypothesis.ripples == (None,) * ur10e.n


def test_left_out_it_is_in_the_noise(ur10e: Arm, rippling: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    quiet = rippling.solved.noise.sigma[WRIST]
    monkeypatch.setattr(ripple_cycles, "LEAST_GAIN", np.inf)
    assert fitted(ur10e, AMPLITUDE).solved.noise.sigma[WRIST] > 1.1 * quiet


def test_slow_ripple_is_left_to_the_catalogue() -> None:
    assert max(CANDIDATES) < FEWEST


def test_the_corrected_arm_holds_it_and_the_refit_lists_it(ur10e: Arm, rippling: Fit) -> None:
    f, joint = rippling, ur10e.joint_names[WRIST]
    (written,) = [e for e in correction(f).effects if e.effect == "gear_ripple"]
    assert written.joint == joint
    motion = fourier_motion(ur10e, 1, 16.0, 125.0)
    holding = with_effect(ur10e, written)
    added = (predict(holding, motion) - predict(ur10e, motion))[:, WRIST]
    true = AMPLITUDE * np.sin(CYCLES * motion.q[:, WRIST] + 0.7)
    assert np.std(added - true) < 0.25 * np.std(true)
    (listed,) = [m for m in calibration(f) if m.name.startswith("gear ripple")]
    assert (listed.joint, listed.before, listed.after) == (joint, 0.0, written.parameters["amplitude"])
    assert 0.5 < listed.gap_share <= 1.0


def test_a_ripple_that_the_arm_holds_is_neither_fitted_again_nor_lost(ur10e: Arm, rippling: Fit) -> None:
    arm = correction(rippling).of(ur10e)
    again = fitted(arm, AMPLITUDE)
    assert again.hypothesis.ripples == (None,) * arm.n
    joint = ur10e.joint_names[WRIST]
    assert correction(again).of(arm).effect("gear_ripple", joint) == arm.effect("gear_ripple", joint)


def test_one_hypothesis_has_the_same_ripple_with_other_effects(ur10e: Arm) -> None:
    ripples = (None, Ripple(100.0, 0.1), None, None, None, None)
    hypothesis = Hypothesis(ur10e, np.full(6, 1e-4), np.zeros(6), ripples=ripples)
    assert hypothesis.with_effects(()).ripple_of(1) == ripples[1]
    assert hypothesis.as_written().ripple_of(1) == ripples[1]
    assert Hypothesis.nominal(ur10e).ripple_of(1) is None
