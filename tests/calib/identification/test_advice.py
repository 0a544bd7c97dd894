"""The advised motion determines the parameters that it names, and a well-recorded arm needs no advice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from benchmarks.known_truth import HOME
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.identification import advice as advice_module
from calib.identification.advice import advice, sentence
from calib.identification.base_fit import BaseFit, Options, fitted
from calib.identification.estimates import base_estimates
from calib.identification.identify import identify
from calib.identification.model import TorqueModel
from calib.identification.prior import nominal_prior
from sim.arm import Arm
from sim.trajectory import Trajectory
from tests.calib.conftest import recorded, varied

NARROW = Options(slip_width=1e-4, cutoff=8.0)


def slow_motion(arm: Arm) -> Trajectory:
    """Thirty seconds of motion in which inertia hardly shows."""
    motion = random_fourier(Basis(3, 30.0), HOME, np.random.default_rng(2))
    speed = np.abs(motion.sampled(20.0).dq).max(axis=0)
    return Fourier(motion.basis, HOME, motion.x * (0.15 * arm.dq_max / speed)[:, None]).sampled(200.0)


def unknown_of(arm: Arm, fit: BaseFit) -> list[int]:
    estimates = base_estimates(fit.model, fit.solution, nominal_prior(arm, fit.model))
    return [k for k, e in enumerate(estimates) if not e.identifiable]


def test_the_motion_that_is_named_helps_as_it_says(ur5e: Arm) -> None:
    truth = varied(ur5e, 6)
    log = recorded(truth, slow_motion(ur5e), 1)
    fit = fitted(ur5e, [log], NARROW)
    unknown = unknown_of(ur5e, fit)
    assert "Ia_3" in [fit.model.names[k] for k in unknown]
    entries = advice(fit.model, fit.solution, nominal_prior(ur5e, fit.model), unknown, HOME)
    item = next(a for a in entries if "Ia_3" in a.parameters)
    assert "elbow_joint" in item.motion
    assert "fast" in item.motion
    assert item.path is not None
    assert "Ia_3" in sentence(item, most=99)
    # the same path at the arm's rate
    t = np.arange(0.0, item.path.t[-1], 1 / 200.0)
    spline = CubicHermiteSpline(item.path.t, item.path.q, item.path.dq)
    path = Trajectory(t, spline(t), spline(t, 1), spline(t, 2))
    both = fitted(ur5e, [log, recorded(truth, path, 2)], NARROW)
    now, then = item.std[item.parameters.index("Ia_3")]
    k = fit.model.names.index("Ia_3")
    found = float(np.sqrt(both.solution.covariance[k, k]))
    assert then < 0.6 * now
    assert then / 2 < found < 2 * then


def test_a_motion_that_improves_much_is_advised_though_it_does_not_determine(
    ur5e: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(advice_module, "CONTRACTION", 0.0)
    monkeypatch.setattr(advice_module, "RELATIVE", 0.0)
    fit = fitted(ur5e, [recorded(varied(ur5e, 6), slow_motion(ur5e), 1)], NARROW)
    entries = advice(fit.model, fit.solution, nominal_prior(ur5e, fit.model), unknown_of(ur5e, fit), HOME)
    helping = [a for a in entries if a.path is not None]
    assert "Ia_3" in [name for a in helping for name in a.parameters]
    for a in helping:
        assert all(then < advice_module.WORTH * now for now, then in a.std)


def test_what_is_advised_stands_in_the_result(ur5e: Arm) -> None:
    found = identify(ur5e, [recorded(varied(ur5e, 6), slow_motion(ur5e), 1)], options=NARROW).result
    named = {name for _, names in found.advice for name in names}
    assert named == {e.name.split(" ")[0] for e in found.estimates if not e.identifiable}
    assert any(sentence_of.startswith("for ") and "move " in sentence_of for sentence_of in found.findings)
    assert found.as_dict()["advice"]


def test_nothing_unknown_needs_no_advice(ur5e: Arm) -> None:
    fit = fitted(ur5e, [recorded(ur5e, slow_motion(ur5e), 1)], NARROW)
    assert advice(fit.model, fit.solution, nominal_prior(ur5e, fit.model), [], HOME) == ()


def test_no_advised_motion_leaves_the_limits(ur5e: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = replace(ur5e, q_min=HOME - 1.0, q_max=np.where(np.arange(6) == 4, HOME + 0.03, HOME + 1.8))
    fit = fitted(ur5e, [recorded(ur5e, slow_motion(ur5e), 1)], NARROW)
    model = TorqueModel.of_arm(narrow)
    every = range(model.p)
    seen = list[Trajectory]()
    information = advice_module._information
    monkeypatch.setattr(advice_module, "_information", lambda m, s, path: (seen.append(path), information(m, s, path))[1])
    advice(model, fit.solution, nominal_prior(narrow, model), every, HOME)
    assert len(seen) > 20
    for path in seen:
        assert np.all(path.q >= narrow.q_min)
        assert np.all(path.q <= narrow.q_max)
        assert not path.dq[:, 4].any()
