"""Identification on logs of known truth, on real recordings if present, and on unsuitable logs."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import main as program
from calib.identification.base_fit import Options
from calib.identification.calibrated import write_calibrated
from calib.identification.identify import identify
from calib.identification.law import Laws
from calib.identification.least_squares import ordinary
from calib.identification.model import TorqueModel
from calib.validation.validate import checked
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import BadLog
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from tests.calib.conftest import fourier_motion, recorded, varied

DATA = os.environ.get("ARM_CALIB_DATA")
# RMSE on held-out logs of a straightforward weighted least squares, A (issue 2); to be reached within 5 %
HELD_OUT = np.array([0.352, 0.338, 0.195, 0.063, 0.079, 0.054])


@pytest.mark.parametrize("name", ["ur3e", "ur5e", "ur10e", "ur16e", "ur20", "servo6"])
def test_the_base_set_is_that_of_the_kinematics(name: str) -> None:
    body = RigidBody(load_arm(name))
    assert (len(body.base()), len(body.base(rotor=False))) == (40, 36)


def test_a_known_arm_is_found_again(ur5e: Arm) -> None:
    truth = varied(ur5e, 1)
    logs = [recorded(truth, fourier_motion(ur5e, seed), seed) for seed in (1, 2)]
    held = recorded(truth, fourier_motion(ur5e, 9), 9)
    found = identify(ur5e, logs, [held])
    expected = TorqueModel.of_arm(truth).nominal()
    std = np.sqrt(np.diag(found.result.covariance))
    off = np.abs(found.solution.theta - expected) / std
    assert np.mean(off < 2) > 0.85
    assert off.max() < 5
    assert found.result.holdout is not None
    assert np.all(found.result.holdout.after < 0.05 * np.abs(held.tau).max(axis=0))
    assert np.all(found.result.holdout.after < found.result.holdout.before)


def test_the_exported_arm_can_exist_and_predicts_like_the_fit(ur5e: Arm, tmp_path: Path) -> None:
    truth = varied(ur5e, 2)
    logs = [recorded(truth, fourier_motion(ur5e, seed), seed) for seed in (3, 4)]
    found = identify(ur5e, logs)
    for inertia in found.arm.tree.inertia:
        moments = np.linalg.eigvalsh(inertia)
        assert moments[0] > 0
        assert moments[0] + moments[1] > moments[2]
    loaded = write_calibrated(tmp_path / "arm", ur5e, found.arm)
    motion = fourier_motion(ur5e, 5, seconds=4.0)
    again = RigidBody(loaded).inverse_dynamics(motion.q, motion.dq, motion.ddq)
    assert np.allclose(again, RigidBody(found.arm).inverse_dynamics(motion.q, motion.dq, motion.ddq), atol=1e-9)
    assert loaded.effect("viscous_friction", "elbow_joint").parameters == pytest.approx(
        found.arm.effect("viscous_friction", "elbow_joint").parameters, rel=1e-12
    )


def test_where_no_joint_has_a_law_the_parameters_that_leave_less_are_kept(ur5e: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters fitted with laws also fit rows at rest. On a published arm they had half its dry friction."""
    stated = replace(ur5e, prior=ur5e.prior.model_copy(update={"numbers": "cad"}))
    truth = varied(stated, 1)
    logs = [recorded(truth, fourier_motion(stated, seed), seed) for seed in (1, 2)]

    def spoilt(model: TorqueModel, *rest: object) -> list[Laws]:
        theta = TorqueModel.of_arm(truth).nominal()
        theta[model.friction_column("coulomb", 2)] *= 0.5
        return [Laws((), theta, np.eye(model.p) * 1e-9, np.zeros(6), np.zeros(6))]

    monkeypatch.setattr("calib.identification.identify.fitted_laws", spoilt)
    fit = identify(stated, logs)
    dry = fit.model.friction_column("coulomb", 2)
    assert fit.solution.theta[dry] == pytest.approx(TorqueModel.of_arm(truth).nominal()[dry], rel=0.1)


def test_a_joint_that_hardly_moves_is_named(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1)
    q, dq, ddq = (x.copy() for x in (motion.q, motion.dq, motion.ddq))
    q[:, 4], dq[:, 4], ddq[:, 4] = q[0, 4], 0.0, 0.0
    with pytest.raises(BadLog, match="wrist_2_joint"):
        identify(ur5e, [recorded(ur5e, Trajectory(motion.t, q, dq, ddq))])


def test_little_motion_says_what_it_does_not_show(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1, seconds=6.0)
    found = identify(ur5e, [recorded(ur5e, motion)])
    unknown = [e.name for e in found.result.estimates if not e.identifiable]
    assert unknown
    kept = next(claim for claim in found.result.claims if claim.name == "kept")
    assert set(kept.numbers["names"]) <= set(unknown)
    assert kept.sentence in found.result.outcome


def test_masses_only_keeps_the_inertias(ur5e: Arm) -> None:
    log = recorded(varied(ur5e, 3), fourier_motion(ur5e, 1))
    found = identify(ur5e, [log], options=Options(masses_only=True))
    shift = found.arm.tree.com - ur5e.tree.com
    for i in range(6):
        # the inertia about the nominal centre of mass stays; about its own it is less by at most m |shift|^2
        change = np.abs(found.arm.tree.inertia[i] - ur5e.tree.inertia[i]).max()
        assert change <= found.arm.tree.mass[i] * (shift[i] @ shift[i]) + 1e-6


def test_reversals_count_apart(ur5e: Arm) -> None:
    truth = varied(ur5e, 1)
    found = identify(ur5e, [recorded(truth, fourier_motion(ur5e, 1))], [recorded(truth, fourier_motion(ur5e, 9))])
    for gap in (found.result.training, found.result.holdout):
        assert gap is not None
        assert gap.sliding is not None
        assert np.all(gap.sliding <= 1.05 * gap.after)


def test_arrays_that_were_filtered_elsewhere(ur5e: Arm) -> None:
    model, motion = TorqueModel.of_arm(ur5e), fourier_motion(ur5e, 1)
    noise = 0.1 * np.random.default_rng(0).standard_normal(motion.q.shape)
    tau = np.einsum("kjp,p->kj", model.columns(motion.q, motion.dq, motion.ddq), model.nominal())
    theta, std, condition = ordinary(model, motion.q, motion.dq, motion.ddq, tau + noise)
    assert np.mean(np.abs(theta - model.nominal()) < 2 * std) > 0.85
    exact, _, _ = ordinary(model, motion.q, motion.dq, motion.ddq, tau)
    assert exact == pytest.approx(model.nominal(), abs=1e-8)
    assert 10 < condition < 1e3


@pytest.mark.skipif(DATA is None, reason="ARM_CALIB_DATA names no folder with the real recordings")
def test_real_recordings_reach_the_baseline(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(str(DATA)) / "ur10e"
    training = [str(folder / f"excitation_{x}.csv") for x in ("20s_8h", "20s_10h", "30s_12h", "40s_12h")]
    held = [str(folder / f"excitation_{x}.csv") for x in ("20s_5h", "50s_12h", "free_b")]
    out = tmp_path / "real"
    assert program.main(["identify", "ur10e", *training, "--holdout", *held, "--out", str(out)]) == 0
    assert "after [A]" in capsys.readouterr().out
    result = json.loads((out / "result.json").read_text())
    assert np.all(np.array(result["holdout"]["after_ampere"]) <= 1.05 * HELD_OUT)
    assert result["holdout"]["logs"] == [Path(x).name for x in held]
    assert load_arm(out / "arm").n == 6
    assert (out / "report.html").is_file()


def test_a_gain_of_the_reading_does_not_scale_what_the_fit_changes(ur5e: Arm) -> None:
    """The arm's own gain applies to the fitted torque once: what identify reports is what the written arm leaves."""
    gain = ArmEffect("torque_gain", "shoulder_lift_joint", {"gain": 1.5})
    truth = with_effect(varied(ur5e, 3, 0.10), gain)
    logs = [recorded(truth, fourier_motion(ur5e, seed, seconds=20.0, rate=125.0), noise=0.3) for seed in (1, 2, 4)]
    found = identify(with_effect(ur5e, gain), logs[:2], [logs[2]], Options(laws=False))
    assert found.result.holdout is not None
    left = checked(found.arm, logs[2], None).residual
    assert np.asarray(found.result.holdout.after) == pytest.approx(left, rel=0.02)
    assert left[1] < 1.2 * checked(truth, logs[2], None).residual[1]
