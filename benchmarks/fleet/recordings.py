"""Synthetic recordings: Fourier motion, torque from `sim.prediction` of arms that vary about their model, sensor noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.known_truth import fourier_motion
from logs.convert import write_log
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

MODEL = "ur10e"
PERIOD = 20.0
HIDDEN = (
    ArmEffect("payload", None, {"mass": 3.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05}),
    ArmEffect("joint_spring", "elbow_joint", {"stiffness": 20.0, "rest_angle": 0.0}),
    ArmEffect("torque_offset", "shoulder_lift_joint", {"offset": 9.0}),
)
HIDDEN_EVERY = 10
START = 1_750_000_000
FILE_MINUTES = 60.0


def motion(arm: Arm, seed: int, seconds: float, rate: float) -> Trajectory:
    """Fourier motion of PERIOD s, repeated, within the arm's speed and acceleration limits."""
    once = fourier_motion(arm, seed, PERIOD, rate)
    count = round(seconds * rate)
    turn = np.arange(count) % round(PERIOD * rate)
    return Trajectory(np.arange(count) / rate, once.q[turn], once.dq[turn], once.ddq[turn])


def recorded(arm: Arm, path: Trajectory, seed: int) -> Log:
    """The motion as the arm's sensors report it."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(path.q.shape) * np.array(arm.sensors.torque_noise)
    step = arm.sensors.encoder_resolution
    q = np.round((path.q + step * rng.uniform(-0.5, 0.5, path.q.shape)) / step) * step
    nan = np.full(path.q.shape, np.nan)
    return Log(arm.joint_names, path.t, path.t, q, path.dq, predict(arm, path) + noise, nan, nan, path.q, path.dq, nan)


def individual(arm: Arm, seed: int, spread: float = 0.05) -> Arm:
    """An arm that differs from its model as arms of one make do.

    Relative std: `spread` for every effect parameter (friction, reflected inertia), 0.3 of it for masses. Inertias scale with
    the mass.
    """
    rng = np.random.default_rng(seed)
    mass = arm.tree.mass * (1 + 0.3 * spread * rng.standard_normal(arm.n))
    tree = replace(arm.tree, mass=mass, inertia=arm.tree.inertia * (mass / arm.tree.mass)[:, None, None])
    effects = [
        ArmEffect(e.effect, e.joint, {k: v * (1 + spread * rng.standard_normal()) for k, v in e.parameters.items()})
        for e in arm.effects
    ]
    return replace(arm, tree=tree, effects=tuple(effects))


def write_recording(file: Path, arm: Arm, log: Log, cell: str, serial: str, kind: str) -> None:
    """Write a recording as `calib record` does: finished, with arm, cell and serial number."""
    words = {
        "arm": arm.name, "arm_sha256": arm.sha256, "cell": cell, "serial": serial, "motion": kind, "end_reason": "completed",
        "wall_clock_start_ns": str(START * 10**9),
    }  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    write_log(log, file, "clean", words)


def plant(folder: Path, arms: int, seconds: float, rate: float = 125.0) -> dict[str, ArmEffect]:
    """Write recordings of `arms` arms. Every HIDDEN_EVERY-th has an effect that its model does not have: cell -> effect.

    Existing recordings are kept.
    """
    model = load_arm(MODEL)
    hidden = {}
    for k in range(arms):
        cell = f"cell-{k:03d}"
        truth = individual(model, k)
        if k % HIDDEN_EVERY == 3:
            hidden[cell] = HIDDEN[k // HIDDEN_EVERY % len(HIDDEN)]
            truth = with_effect(truth, hidden[cell])
        for kind, share, which, seed in (("excitation", 0.8, k % 7, k), ("validation", 0.2, 7 + k % 5, 10_000 + k)):
            file = folder / cell / f"{kind}.mcap"
            if not file.exists():
                log = recorded(truth, motion(model, which, seconds * share, rate), seed)
                write_recording(file, model, log, cell, f"S{k:05d}", kind)
    return hidden


def shift(folder: Path, truth: Arm, minutes: float) -> Iterator[Path]:
    """Recordings of work at 500 Hz. Hours are split into one file per hour, with the same motion and fresh noise."""
    for k in range(math.ceil(minutes / FILE_MINUTES)):
        file = folder / f"{min(minutes, FILE_MINUTES):g}-{k}.mcap"
        if not file.exists():
            write_recording(file, load_arm(MODEL), _worked(truth, min(minutes, FILE_MINUTES), k), "long", "S1", "work")
        yield file


def _worked(truth: Arm, minutes: float, seed: int) -> Log:
    path = motion(truth, 1, minutes * 60, 500.0)
    parts = [slice(k, k + 100_000) for k in range(0, len(path.t), 100_000)]
    rng = np.random.default_rng(seed)
    tau = np.concatenate([predict(truth, Trajectory(path.t[s], path.q[s], path.dq[s], path.ddq[s])) for s in parts])
    tau += rng.standard_normal(tau.shape) * np.array(truth.sensors.torque_noise)
    q = path.q + 1e-5 * rng.standard_normal(path.q.shape)
    nan = np.broadcast_to(np.float64(np.nan), q.shape)
    return Log(truth.joint_names, path.t, path.t, q, path.dq, tau, nan, nan, nan, nan, nan)
