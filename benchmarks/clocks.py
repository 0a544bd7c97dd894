"""Time in a recording: accuracy of the fit between two clocks and of the torque delay, against known values."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.measurement.torque_delay import torque_delay
from logs.clock_fit import fit_clocks
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.prediction import predict
from sim.trajectory import Trajectory

ARM, RATE, FINE = "ur10e", 500.0, 4000.0
HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
MINUTE = 30_000
JUMP = 0.006


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def two_clocks(rng: np.random.Generator, skew: float, jump: float) -> tuple[np.ndarray, np.ndarray]:
    """Device and host times, s, of a minute at 500 Hz with a latency tail and a jump halfway.

    Latency: 0.3 ms plus an exponential tail of 0.2 ms; one sample in 500 is late by 10 ms on average.
    """
    device = np.maximum.accumulate(np.arange(MINUTE) / RATE + rng.normal(0, 2e-5, MINUTE))
    latency = 3e-4 + rng.exponential(2e-4, MINUTE) + (rng.random(MINUTE) < 0.002) * rng.exponential(0.01, MINUTE)
    return device, device * (1 + skew) + latency + jump * (device >= device[MINUTE // 2])


def clock_rows(repeats: int) -> list[dict[str, Any]]:
    """Skew errors, and jumps found, over random skews."""
    rng = np.random.default_rng(0)
    wrong, found, false = [], 0, 0
    for _ in range(repeats):
        skew = rng.uniform(-300e-6, 300e-6)
        plain, jumped = fit_clocks(*two_clocks(rng, skew, 0.0)), fit_clocks(*two_clocks(rng, skew, JUMP))
        assert plain is not None
        assert jumped is not None
        wrong.append(abs(plain.skew - skew))
        false += len(plain.jumps)
        found += len(jumped.jumps) == 1 and abs(jumped.jumps[0][1] - JUMP) < 2e-4
    note = f"a minute at 500 Hz, skew within 300 ppm, latency with a tail; {repeats} times"
    return [
        row("skew of the clocks, error p50/worst", f"{np.median(wrong) * 1e6:.2f}/{max(wrong) * 1e6:.2f}", "ppm", "", note),
        row(f"jumps of {JUMP * 1e3:g} ms found, of {repeats}", found, "", str(repeats), "reported within 0.2 ms"),
        row("jumps reported where there are none", false, "", "0", f"{repeats} minutes"),
    ]


def swing(seconds: float) -> Trajectory:
    """Slow sines and a small sweep from 0.5 to 6 Hz on every joint, finely sampled."""
    t = np.arange(0.0, seconds, 1 / FINE)
    k = np.arange(len(HOME))
    sweep = 0.5 + 5.5 * t / seconds
    size = 0.35 / (1 + 0.4 * sweep**2)
    small = (size * np.sin(2 * np.pi * (0.5 * t + 2.75 * t**2 / seconds)))[:, None]
    q = HOME + 0.5 * np.sin(2 * np.pi * (0.11 + 0.02 * k) * t[:, None] + k) + small
    dq = np.gradient(q, 1 / FINE, axis=0)
    return Trajectory(t, q, dq, np.gradient(dq, 1 / FINE, axis=0))


def late(motion: Trajectory, torque: np.ndarray, arm: Arm, delay: float, rng: np.random.Generator) -> Log:
    """Readings at RATE with the torque lagging by `delay`, with the arm's own noise."""
    t = np.arange(0.02, motion.t[-1] - 0.02, 1 / RATE)
    q = np.stack([np.interp(t, motion.t, x) for x in motion.q.T], axis=1)
    tau = np.stack([np.interp(t - delay, motion.t, x) for x in torque.T], axis=1)
    tau += rng.standard_normal(tau.shape) * arm.sensors.torque_noise
    q += rng.standard_normal(q.shape) * arm.sensors.encoder_resolution
    nothing = np.full(q.shape, np.nan)
    return Log(arm.joint_names, t, t, q, nothing, tau, nothing, nothing, nothing, nothing, nothing)


def delay_rows(repeats: int, seconds: float = 30.0) -> list[dict[str, Any]]:
    """Estimates of delays between torque and motion of zero, half a sample (both signs) and one sample."""
    arm, motion, rng, out = load_arm(ARM), swing(seconds), np.random.default_rng(0), []
    torque = predict(arm, motion)
    for samples in (0.0, 0.5, -0.5, 1.0):
        found = [torque_delay(late(motion, torque, arm, samples / RATE, rng), arm) for _ in range(repeats)]
        error = np.array([f.delay * RATE - samples for f in found])
        std = float(np.median([f.std for f in found])) * RATE
        significant = sum(f.significant for f in found)
        note = f"stated std {std:.3f}; reported as significant in {significant} of {repeats}; {seconds:g} s at 500 Hz, the arm's own noise"
        out.append(
            row(
                f"delay of {samples:+.1f} samples, worst error of {repeats}",
                f"{np.abs(error).max():.3f}",
                "samples",
                "< 0.5",
                note,
            )
        )
    return out


def run(repeats: int = 50, delays: int = 5) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    return [*clock_rows(repeats), *delay_rows(delays)]
