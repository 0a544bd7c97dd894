"""A delay of half a sample between torque and motion is found, and none is found where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.exam import motions
from benchmarks.exam.arms import HARDWARE, write_model
from benchmarks.exam.recording import sample, write
from benchmarks.exam.true_arm import AMBIENT, build, run
from calib.measurement import ripple_cycles
from calib.measurement.torque_delay import torque_delay
from logs.log import Log
from logs.read import read_log
from sim.arm import Arm, load_arm
from sim.errors import BadLog
from sim.prediction import predict
from sim.trajectory import Trajectory

RATE = 200.0


def chirps(seconds: float = 30.0, finest: float = 4000.0) -> Trajectory:
    """A slow swing and a small sweep from 0.5 to 6 Hz on every joint, finely sampled."""
    t = np.arange(0.0, seconds, 1 / finest)
    k = np.arange(6)
    sweep = 0.5 + 5.5 * t / seconds
    phase = 2 * np.pi * (0.5 * t + 2.75 * t**2 / seconds)
    slow = 2 * np.pi * (0.11 + 0.02 * k)
    size = 0.35 / (1 + 0.4 * sweep**2)
    q = 0.5 * np.sin(slow * t[:, None] + k) + (size * np.sin(phase))[:, None]
    q += np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
    dq = np.gradient(q, 1 / finest, axis=0)
    return Trajectory(t, q, dq, np.gradient(dq, 1 / finest, axis=0))


def delayed(arm: Arm, motion: Trajectory, delay: float, seed: int) -> Log:
    """Readings at RATE with noise, slightly off the grid; the torque channel lags by `delay`."""
    rng = np.random.default_rng(seed)
    torque = predict(arm, motion)
    t = np.arange(0.02, motion.t[-1] - 0.02, 1 / RATE)
    t = t + rng.uniform(-2e-4, 2e-4, len(t))
    at = [np.interp(t, motion.t, x) for x in motion.q.T]
    tau = np.stack([np.interp(t - delay, motion.t, x) for x in torque.T], axis=1)
    tau += 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    q = np.stack(at, axis=1) + 1e-5 * rng.standard_normal(tau.shape)
    nan = np.full(q.shape, np.nan)
    return Log(arm.joint_names, t, t, q, nan, tau, nan, nan, nan, nan, nan)


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    return chirps()


@pytest.mark.parametrize("delay", [0.0, 0.5 / RATE, -0.5 / RATE, 2 / RATE])
def test_the_delay_is_found(motion: Trajectory, delay: float) -> None:
    arm = load_arm("ur5e")
    found = torque_delay(delayed(arm, motion, delay, seed=1), arm)
    assert found.period == pytest.approx(1 / RATE, rel=0.01)
    assert abs(found.delay - delay) < max(4 * found.std, 1e-4)
    assert found.std < 2e-4
    assert np.nanmax(np.abs(found.per_joint - delay)) < 1.5e-3


def test_whether_it_matters(motion: Trajectory) -> None:
    arm = load_arm("ur5e")
    assert torque_delay(delayed(arm, motion, 1.0 / RATE, seed=2), arm).significant
    assert all(torque_delay(delayed(arm, motion, 0.5 / RATE, seed=s), arm).significant for s in (2, 3))
    assert not torque_delay(delayed(arm, motion, 0.1 / RATE, seed=2), arm).significant


def test_a_log_in_which_nothing_moves_cannot_tell(motion: Trajectory) -> None:
    arm = load_arm("ur5e")
    still = replace(motion, q=np.tile(motion.q[:1], (len(motion), 1)), dq=0 * motion.dq, ddq=0 * motion.ddq)
    with pytest.raises(BadLog, match="no joint moves long and fast enough"):
        torque_delay(delayed(arm, still, 0.0, seed=3), arm)


@pytest.mark.parametrize("delay", [0.0, 5e-3])
def test_a_drive_that_answers_the_ripple_of_its_gears_is_not_early(
    delay: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In closed loop with a mismatched model, the drive's reaction to the gear ripple appears in both motion and torque."""
    nominal = write_model("servo6", tmp_path / "arm.xml")
    rng, hardware = np.random.default_rng(5), HARDWARE["servo6"]
    home = motions.draw_home(rng)
    reference = motions.fourier_motion(rng, home, hardware.speed, 12.0, 5, hardware.control_period)
    truth = build("servo6", nominal.tree, nominal.tau_max, hardware, home, rng, hard=True)
    truth.sensors.delay += delay
    warm = np.full(6, AMBIENT)
    write(tmp_path / "log.mcap", sample(truth, run(truth, reference, motions.SETTLE, warm), rng), nominal.joint_names, 0)
    log = read_log(tmp_path / "log.mcap", nominal.joint_names)
    found = torque_delay(log, nominal)
    assert abs(found.delay - truth.sensors.delay) < 3e-3
    monkeypatch.setattr(ripple_cycles, "LEAST_GAIN", np.inf)
    assert torque_delay(log, nominal).delay < found.delay - 6e-3
