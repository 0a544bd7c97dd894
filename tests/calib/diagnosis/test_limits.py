"""A drive at its torque limit is distinguished from one that only works hard."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.whole import diagnose_pieces
from calib.measurement.limits import Limit, limits_reached
from logs import Pieces
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from tests.calib.diagnosis.conftest import at, recording

ELBOW = 2


def at_limit(arm: Arm, limit: float, behind: float, seed: int = 1, noise: float = 0.2) -> Log:
    """A recording whose elbow gives at most `limit` N m and lags its command by `behind` rad while at the limit."""
    log = recording(arm, seed)
    rng = np.random.default_rng(seed)
    t = log.t
    wanted = 60.0 * np.sin(2 * np.pi * 0.35 * t) + 25.0 * np.sin(2 * np.pi * 0.12 * t)
    tau = log.tau.copy()
    tau[:, ELBOW] = np.clip(wanted, -limit, limit) + noise * rng.standard_normal(len(t))
    q_cmd = log.q + 5e-4 * np.sin(7.0 * t)[:, None]
    q_cmd[:, ELBOW] += np.where(np.abs(wanted) > limit, behind, 0.0)
    return replace(log, tau=tau, q_cmd=q_cmd)


def test_a_limit_is_found_with_its_level(ur10e: Arm) -> None:
    (found,) = limits_reached(ur10e, [at_limit(ur10e, 50.0, 0.08)])
    assert found.effect.effect == "torque_saturation"
    assert found.effect.joint == "elbow_joint"
    assert found.effect.parameters["limit"] == pytest.approx(50.0, rel=0.01)
    assert found.times > 2
    assert found.std < 1.0


def test_a_level_that_another_recording_exceeds_is_no_limit(ur10e: Arm) -> None:
    log = at_limit(ur10e, 50.0, 0.08)
    assert limits_reached(ur10e, [log, at_limit(ur10e, 50.0, 0.08, seed=2)])
    assert limits_reached(ur10e, [log, at_limit(ur10e, 65.0, 0.0, seed=2)]) == []


def test_a_joint_that_stands_at_its_reversals_has_no_limit(ur10e: Arm) -> None:
    """Dry friction holds the joint while its torque builds up: a clean mock's following error was 263 times the usual."""
    assert limits_reached(ur10e, [at_limit(ur10e, 50.0, 0.04)]) == []


def test_noise_above_the_limit_hides_neither_it_nor_its_level(ur10e: Arm) -> None:
    (found,) = limits_reached(ur10e, [at_limit(ur10e, 40.0, 0.08, noise=2.0)])
    assert found.effect.parameters["limit"] == pytest.approx(40.0, rel=0.02)


def test_levels_that_spread_a_little_are_of_one_limit(ur10e: Arm) -> None:
    """Noise and the drive's temperature shift a limit by a few per cent between one time at it and the next."""
    (found,) = limits_reached(ur10e, [at_limit(ur10e, 48.8, 0.08), at_limit(ur10e, 51.2, 0.08, seed=2)])
    assert 0.02 < found.std / found.effect.parameters["limit"] < 0.03
    assert limits_reached(ur10e, [at_limit(ur10e, 47.5, 0.08), at_limit(ur10e, 52.5, 0.08, seed=2)]) == []


def test_the_way_back_from_a_limit_is_no_usual_error(ur10e: Arm) -> None:
    """A joint that fell behind catches up for seconds after its torque has left the limit."""
    log = at_limit(ur10e, 50.0, 0.08)
    late = np.convolve(np.abs(log.q_cmd[:, ELBOW] - log.q[:, ELBOW]) > 0.05, np.ones(34), mode="full")[: len(log.t)] > 0
    assert 0.08 < (late & (np.abs(log.tau[:, ELBOW]) < 42.0)).mean() < 0.2
    q_cmd = log.q_cmd.copy()
    q_cmd[:, ELBOW] += 0.05 * late
    (found,) = limits_reached(ur10e, [replace(log, q_cmd=q_cmd)])
    assert found.effect.parameters["limit"] == pytest.approx(50.0, rel=0.01)


def test_an_error_of_some_encoder_steps_is_no_lag(ur10e: Arm) -> None:
    """A joint with a coarse encoder lags by a few steps only, where its load and friction make the torque flat."""
    log, step = at_limit(ur10e, 50.0, 0.0), 1.1e-4
    q = np.round(log.q / step) * step
    q_cmd = q.copy()
    q_cmd[:, ELBOW] += np.where(np.abs(log.tau[:, ELBOW]) > 49.0, 9 * step, 0.0)
    assert [x.effect.joint for x in limits_reached(ur10e, [replace(log, q=log.q, q_cmd=log.q + (q_cmd - q))])] == [
        "elbow_joint"
    ]
    assert limits_reached(ur10e, [replace(log, q=q, q_cmd=q_cmd)]) == []


@pytest.mark.slow
def test_a_limit_beside_a_name_is_told_and_written_and_survives_a_long_recording(
    ur10e: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = ArmEffect("torque_saturation", "shoulder_pan_joint", {"limit": 150.0})
    monkeypatch.setattr("calib.diagnosis.diagnose.limits_reached", lambda arm, logs: [Limit(limit, 0.5, 400.0, 3)])
    spring = at(ELBOW, lambda q, dq: 12.0 * (q - 0.4))
    logs = [recording(ur10e, seed, spring, seconds=12.0) for seed in (1, 2, 3)]
    short = diagnose(ur10e, logs[:2], logs[2:])
    long, _ = diagnose_pieces(ur10e, Pieces(*logs), [recording(ur10e, 9, spring)], most=25.0)
    for found in (short, long):
        found_effects = {(e["effect"], e["joint"]): e for e in found.answer["effects"]}
        assert set(found_effects) == {("joint_spring", "elbow_joint"), ("torque_saturation", "shoulder_pan_joint")}
        assert found_effects["torque_saturation", "shoulder_pan_joint"]["parameters"]["limit"]["value"] == 150.0
        assert found_effects["torque_saturation", "shoulder_pan_joint"]["confidence"] == pytest.approx(400 / 530)
        assert found_effects["torque_saturation", "shoulder_pan_joint"]["measured_by"] == "lag behind the command"
        found.write(tmp_path, ur10e)
        written = load_arm(tmp_path / "arm").effect("torque_saturation", "shoulder_pan_joint")
        assert written is not None
        assert written.parameters == {"limit": 150.0}


def test_an_arm_that_follows_at_its_largest_torque_has_no_limit(ur10e: Arm) -> None:
    assert limits_reached(ur10e, [at_limit(ur10e, 50.0, 1e-3)]) == []


def test_an_arm_that_lags_without_a_level_has_no_limit(ur10e: Arm) -> None:
    log = at_limit(ur10e, 1e9, 0.0)
    q_cmd = log.q_cmd.copy()
    q_cmd[:, ELBOW] += 0.08 * (np.abs(log.tau[:, ELBOW]) > 50.0)
    assert limits_reached(ur10e, [replace(log, q_cmd=q_cmd)]) == []


def test_a_limit_that_is_reached_once_is_found(ur10e: Arm) -> None:
    log = at_limit(ur10e, 50.0, 0.08)
    behind = np.abs(log.q_cmd[:, ELBOW] - log.q[:, ELBOW]) > 0.05
    began = np.flatnonzero(np.diff(behind.astype(int)) == 1)
    short = slice(0, int(began[1]) - 10)
    once = Log(log.joint_names, *(getattr(log, k)[short] for k in (
        "t", "t_host", "q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")))  # fmt: skip
    (found,) = limits_reached(ur10e, [once])
    assert found.times == 1
    assert found.effect.parameters["limit"] == pytest.approx(50.0, rel=0.01)
    assert found.std > 0.4


def test_the_level_is_not_that_of_the_peaks_of_the_noise(ur10e: Arm) -> None:
    """A low limit under slow noise: the largest readings are noise peaks, 2 to 4 % too high."""
    for seed in (1, 2, 3):
        log = at_limit(ur10e, 15.0, 0.2, seed=seed)
        slow = gaussian_filter1d(np.random.default_rng(seed).standard_normal(len(log.t)), 8)
        tau = log.tau.copy()
        tau[:, ELBOW] += 0.6 * slow / slow.std()
        (found,) = limits_reached(ur10e, [replace(log, tau=tau)])
        assert found.effect.parameters["limit"] == pytest.approx(15.0, rel=0.018)


def test_without_a_command_no_limit_is_found(ur10e: Arm) -> None:
    log = at_limit(ur10e, 50.0, 0.08)
    assert limits_reached(ur10e, [replace(log, q_cmd=np.full_like(log.q, np.nan))]) == []


def test_a_delayed_joint_that_mostly_stands_has_no_limit(ur10e: Arm) -> None:
    """At rest a joint follows exactly. A controller's delay shows as soon as the joint moves, at any torque."""
    log = at_limit(ur10e, 50.0, 0.0)
    t, tau = log.t, log.tau[:, ELBOW]
    dq, q, q_cmd = log.dq.copy(), log.q.copy(), log.q.copy()
    dq[:, ELBOW] = 0.5 * np.sign(tau) * (np.abs(tau) > 40.0)
    q_cmd[:, ELBOW] = np.concatenate([[0.0], np.cumsum(dq[:-1, ELBOW] * np.diff(t))])
    q[:, ELBOW] = np.interp(t - 0.05, t, q_cmd[:, ELBOW])
    assert (np.abs(dq[:, ELBOW]) > 0).mean() < 0.7
    assert limits_reached(ur10e, [replace(log, q=q, dq=dq, q_cmd=q_cmd)]) == []


def test_a_limit_of_a_drive_that_reports_its_current_is_found(ur10e: Arm) -> None:
    arm = replace(ur10e, torque_constant=np.full(6, 10.0))
    log = at_limit(arm, 50.0, 0.08)
    (found,) = limits_reached(arm, [replace(log, tau=np.full_like(log.tau, np.nan), current=log.tau / 10.0)])
    assert found.effect.parameters["limit"] == pytest.approx(50.0, rel=0.01)
