"""Sensor readings of a run, written as a recording with topics, stamps and encoding of the project's log format.

The file is written with the `mcap` library, without metadata and `/events`, like one of a foreign recorder.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from benchmarks.exam.plant import reading
from benchmarks.exam.true_arm import Run, TrueArm
from logs.encode import JointEncoder
from logs.schemas import COMMANDS, DIAGNOSTICS, SCHEMAS, STATES, TOPICS

EPOCH = 1_750_000_000  # s, device clock of the first session
SPEED_WINDOW = 0.008  # s over which the drive differentiates its encoder


@dataclass(frozen=True)
class Samples:
    """t t_host (N,) s; q dq tau q_cmd dq_cmd (N, 6); slow (M,) s with temperature (M, 6) degC."""

    t: np.ndarray
    t_host: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    q_cmd: np.ndarray
    dq_cmd: np.ndarray
    slow: np.ndarray
    temperature: np.ndarray


def encoder(joints: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Readings (N, 6) of angles (N, 6) before quantisation."""
    records = joints.view(np.recarray)
    return np.stack([reading.py_func(records[j], q[:, j]) for j in range(len(joints))], axis=1)


def torque_reading(arm: TrueArm, happened: Run, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Drive torque (N, 6) as the channel reports it at t (N,), without noise."""
    s, dt = arm.sensors, happened.t[1] - happened.t[0]
    tau = happened.tau
    if s.lag > 0:
        from scipy.signal import lfilter

        share = 1 - np.exp(-dt / s.lag)
        tau = lfilter([share], [1, share - 1], tau, axis=0, zi=(1 - share) * tau[:1])[0]
    late = t - s.delay - s.delay_jitter * rng.uniform(-1, 1, len(t))
    out = tau[np.clip(np.round((late - happened.t[0]) / dt).astype(int), 0, len(tau) - 1)]
    largest = np.abs(tau).max(axis=0)
    out = s.gain * (1 - s.gain_fade * np.abs(out) / largest) * out + s.offset
    wander = np.sin(np.pi * t / t[-1] * 0.8)[:, None] * s.drift
    return out + wander + s.hum * np.sin(2 * np.pi * s.hum_rate * t + s.hum_phase)[:, None]


def sample(arm: TrueArm, happened: Run, rng: np.random.Generator) -> Samples:
    """Readings at jittered instants with true time stamps."""
    s, hardware = arm.sensors, arm.hardware
    step = 1 / hardware.log_rate
    count = int(happened.reference.duration * hardware.log_rate)
    t = np.arange(count) * step + step * np.clip(0.04 * rng.standard_normal(count), -0.1, 0.1)
    t[0] = 0.0
    noise = _coloured(rng, count, arm.sensors.colour) * s.noise
    tau = torque_reading(arm, happened, t, rng) + noise
    tau = np.round(tau / (0.02 * hardware.torque_noise)) * (0.02 * hardware.torque_noise)

    def angle(at: np.ndarray) -> np.ndarray:
        seen = np.stack([np.interp(at, happened.t, x) for x in encoder(arm.joints, happened.q).T], axis=1)
        return np.round(seen / hardware.resolution) * hardware.resolution

    q = angle(t)
    dq = (q - angle(t - SPEED_WINDOW)) / SPEED_WINDOW + hardware.speed_noise * rng.standard_normal(q.shape)
    latest = np.clip(np.searchsorted(happened.instants, t, side="right") - 1, 0, None)
    t_host = 0.4 * rng.uniform() + t * (1 + s.skew) + 2e-4 + rng.exponential(1.5e-4, count)
    slow = np.arange(0.0, t[-1], 1.0)
    warmth = np.stack([np.interp(slow, happened.instants, x) for x in happened.temperature.T], axis=1)
    keep = np.ones(count, dtype=bool)
    if s.lost > 0:
        keep = rng.uniform(size=count) >= s.lost
        burst = rng.integers(count // 4, count - 20)
        keep[burst : burst + int(rng.integers(2, 7))] = False
        keep[[0, -1]] = True
    return Samples(
        t[keep], np.maximum.accumulate(t_host)[keep], q[keep], dq[keep], tau[keep], happened.reference.q[latest[keep]],
        happened.reference.dq[latest[keep]], slow, np.round(warmth, 1),
    )  # fmt: skip


def write(path: Path, samples: Samples, joint_names: tuple[str, ...], session: int) -> None:
    """Write a recording whose device clock starts `session` s after the epoch."""
    start, host = (EPOCH + session) * 10**9, (EPOCH + session + 3) * 10**9
    encode = JointEncoder(joint_names).body
    nothing = np.full(len(joint_names), np.nan)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "exam")
        schemas = {n: writer.register_schema(n, "ros2msg", SCHEMAS[n].encode()) for n in sorted({TOPICS[x] for x in _WRITTEN})}
        channel = {topic: writer.register_channel(topic, "cdr", schemas[TOPICS[topic]]) for topic in _WRITTEN}
        following = 0
        rows = zip(
            start + np.round(samples.t * 1e9).astype(int), host + np.round(samples.t_host * 1e9).astype(int), samples.q, samples.dq,
            samples.tau, samples.q_cmd, samples.dq_cmd, strict=True,
        )  # fmt: skip
        for k, (stamp, seen, q, dq, tau, q_cmd, dq_cmd) in enumerate(rows):
            stamp, seen = int(stamp), int(seen)
            writer.add_message(channel[COMMANDS], seen, encode(stamp, (q_cmd, dq_cmd, nothing)), stamp)
            writer.add_message(channel[STATES], seen, encode(stamp, (q, dq, tau)), stamp)
            if following < len(samples.slow) and samples.t[k] >= samples.slow[following]:
                body = encode(stamp, (nothing, samples.temperature[following]))
                writer.add_message(channel[DIAGNOSTICS], seen, body, stamp)
                following += 1
        writer.finish()


_WRITTEN = (STATES, COMMANDS, DIAGNOSTICS)


def _coloured(rng: np.random.Generator, count: int, colour: float) -> np.ndarray:
    """AR(1) noise of unit variance, (count, 6)."""
    from scipy.signal import lfilter

    white = rng.standard_normal((count + 50, 6)) * np.sqrt(1 - colour**2)
    return lfilter([1.0], [1.0, -colour], white, axis=0)[50:]
