"""A friction law is the sum of its terms: along a whole path, in parts of it, in a simulation and in an arm's folder."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion
from sim.arm import Arm, ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.effects import EFFECTS, with_effect
from sim.effects.effect import Values
from sim.effects.friction_law import FAMILIES, TERMS, TURNING, WIDTHS, FrictionLaw, formula
from sim.plant import Plant
from sim.prediction import by_stage, link_side, motor_side, predict, torque_of_laws
from sim.torque_path import PathState

LAW = FrictionLaw()
ZERO = dict.fromkeys(TERMS, 0.0)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur5e")


def path(arm: Arm, rate: float = 500.0) -> PathState:
    motion = fourier_motion(arm, 3, 6.0, rate)
    state = link_side(arm, motion, by_stage((), arm))
    motor_side(state, by_stage((), arm))
    return state


def sliced(state: PathState, part: slice) -> PathState:
    own = {k: v[part].copy() for k, v in vars(state).items() if isinstance(v, np.ndarray)}
    return replace(state, **own)


def maxwell(q: np.ndarray, width: float) -> np.ndarray:
    """Dahl's law from sample to sample: an independent implementation."""
    z = np.zeros(len(q))
    for k in range(1, len(q)):
        step = q[k] - q[k - 1]
        z[k] = np.sign(step) + (z[k - 1] - np.sign(step)) * np.exp(-abs(step) / width)
    return z


def test_a_column_is_the_same_whatever_stands_beside_it(arm: Arm) -> None:
    together = LAW.terms(path(arm), 1)
    for k, name in enumerate(TERMS):
        np.testing.assert_array_equal(LAW.terms(path(arm), 1, [name])[:, 0], together[:, k], err_msg=name)
    state = path(arm)
    np.testing.assert_array_equal(LAW.terms(state, 1), LAW.terms(state, 1))


def test_terms_are_their_formulas(arm: Arm) -> None:
    state = path(arm)
    found = dict(zip(TERMS, LAW.terms(state, 1).T, strict=True))
    speed, load = state.dq[:, 1], state.load[:, 1]
    for name, width in zip(FAMILIES["slip"], WIDTHS, strict=True):
        if width >= TURNING:  # narrower ones reverse between two samples
            np.testing.assert_allclose(found[name], maxwell(state.q[:, 1], width), atol=0.05)
    fast = np.abs(speed) > 0.1
    turn = found["slip_1e-3"]
    np.testing.assert_allclose(found["power_2"][fast], (speed * np.abs(speed))[fast], rtol=0.01)
    np.testing.assert_allclose(found["power_1"], speed)
    np.testing.assert_allclose(found["stribeck_0.1"], turn * np.exp(-np.abs(speed) / 0.1))
    np.testing.assert_allclose(found["load"], turn * np.abs(load))
    np.testing.assert_allclose(found["load_driving"], np.where(load * turn > 0, load * turn**2, 0.0))


def applied(state: PathState, joint: int, p: Values) -> np.ndarray:
    state = replace(state, tau=np.zeros_like(state.tau))
    LAW.apply(state, joint, p)
    return state.tau[:, joint]


def test_a_path_in_parts_goes_on_where_it_was(arm: Arm) -> None:
    whole, rng = path(arm), np.random.default_rng(7)
    p = dict(zip(TERMS, rng.normal(size=len(TERMS)), strict=True))
    expected = applied(replace(whole, memory={}), 2, p)
    memory: dict = {}
    parts = [applied(replace(sliced(whole, slice(k, k + 7)), memory=memory), 2, p) for k in range(0, len(whole.t), 7)]
    np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-12)
    assert np.abs(applied(sliced(whole, slice(700, 707)), 2, p)[0] - expected[700]).max() > 0.1  # this needs the memory


def test_the_torque_sample_by_sample_is_that_of_the_path(arm: Arm) -> None:
    whole, rng = path(arm), np.random.default_rng(8)
    for name in TERMS:
        if name in FAMILIES["slip"] and float(name.removeprefix("slip_")) < TURNING:
            continue  # a reversal takes less than one step of the path
        p = dict.fromkeys(TERMS, 0.0) | {name: rng.normal()}
        step, along = applied(replace(whole, memory={}), 2, p), applied(replace(whole, memory=None), 2, p)
        assert np.sqrt(np.mean((step - along) ** 2)) < 0.03 * np.sqrt(np.mean(along**2)), name


def test_it_is_no_candidate_and_the_folder_carries_it(arm: Arm, tmp_path: Path) -> None:
    assert LAW not in EFFECTS
    item = ArmEffect("friction_law", "elbow_joint", ZERO | {"slip_1e-2": 2.0, "power_0.3": -0.4, "load": 0.05})
    motion = fourier_motion(arm, 1, 4.0, 250.0)
    expected = predict(with_effect(arm, item), motion)
    assert np.abs(expected - predict(arm, motion))[:, 2].max() > 1.0
    np.testing.assert_allclose(predict(write_arm(tmp_path / "arm", arm, effects=[item]), motion), expected)
    np.testing.assert_allclose(expected - predict(arm, motion), torque_of_laws([item], arm, motion), atol=1e-9)


def test_the_simulated_arm_feels_it(arm: Arm) -> None:
    item = ArmEffect("friction_law", "elbow_joint", ZERO | {"slip_1e-2": 8.0})
    torques = []
    for truth in (arm, with_effect(arm, item)):
        plant, tau = Plant(truth, arm, seed=1), []
        home = np.array([0.0, -1.5, 1.0, 0.0, 0.0, 0.0])
        plant.reset(home)
        for k in range(600):
            t = k / 500
            q, dq = home.copy(), np.zeros(arm.n)
            q[2], dq[2] = home[2] + 0.2 * (1 - np.cos(2 * t)), 0.4 * np.sin(2 * t)
            plant.command(q, dq, np.zeros(arm.n))
            plant.advance(1 / 500)
            tau.append(plant.read().tau)
        torques.append(np.array(tau))
    sliding = (torques[1] - torques[0])[350:550, 2]  # at least 0.16 rad after the start, so fully built up
    assert sliding.mean() == pytest.approx(8.0, rel=0.1)


def test_the_formula_names_what_is_there() -> None:
    assert formula(ZERO) == "0"
    assert formula(ZERO | {"load": -0.05, "slip_3e-3": 2.0}) == "2 z(0.003) - 0.05 z |load|"


def test_the_module_can_be_imported_before_any_other() -> None:
    subprocess.run([sys.executable, "-c", "import sim.effects.friction_law"], check=True)


def test_the_torque_is_the_terms_times_their_coefficients(arm: Arm) -> None:
    whole, rng = path(arm), np.random.default_rng(9)
    p = dict(zip(TERMS, rng.normal(size=len(TERMS)), strict=True))
    np.testing.assert_allclose(applied(whole, 2, p), LAW.terms(whole, 2) @ np.array([p[name] for name in TERMS]), atol=1e-12)
