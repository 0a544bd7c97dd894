"""Commanded motions: friction sweeps with a chirp, and Fourier series, as references at the drive's control instants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
HOME_SPREAD = np.array([0.6, 0.25, 0.35, 0.4, 0.4, 0.8])
SETTLE = 1.0  # s at rest before a recording starts
REACH = np.array([0.7, 0.7, 0.8, 0.9, 0.9, 0.9])  # rad, reach of a sweep from home


@dataclass(frozen=True)
class Reference:
    """q dq ddq (K, 6) at control instants, from rest to rest; the recording starts SETTLE s after the first."""

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    period: float

    @property
    def duration(self) -> float:
        """Recorded duration, s."""
        return len(self.q) * self.period - SETTLE


def draw_home(rng: np.random.Generator) -> np.ndarray:
    """A posture (6,) from which a session's motions start."""
    return HOME + HOME_SPREAD * rng.uniform(-1.0, 1.0, 6)


def friction_motion(rng: np.random.Generator, home: np.ndarray, speed: float, period: float) -> Reference:
    """Each joint in turn at three constant speeds in both directions, then a small chirp of 0.5-7 Hz on all joints."""
    pieces = [np.zeros((round((SETTLE + 0.5) / period), 6))]
    for j in range(6):
        for v in (
            speed * np.array([rng.uniform(0.06, 0.13), rng.uniform(0.3, 0.5), rng.uniform(0.8, 1.1)]) * (1.0 + 0.4 * (j > 2))
        ):
            ramp = 0.1 + 0.25 * v
            steady = min(2.2, max(0.1, REACH[j] / v - ramp))
            profile = rng.choice([-1.0, 1.0]) * v * _to_and_fro(steady, ramp, period)
            piece = np.zeros((len(profile) + round(0.3 / period), 6))
            piece[: len(profile), j] = profile
            pieces.append(piece)
    dq = np.concatenate([*pieces, _chirp(rng, speed, period)])
    return _integrated(home, dq, period)


def fourier_motion(
    rng: np.random.Generator, home: np.ndarray, speed: float, seconds: float, harmonics: int, period: float
) -> Reference:
    """Two periods of a random Fourier series of `seconds` each, faded in and out."""
    t = np.arange(round((SETTLE + 2 * seconds) / period)) * period - SETTLE
    k = np.arange(1, harmonics + 1)
    a, b = rng.standard_normal((2, 6, harmonics))
    wave = 2 * np.pi / seconds * np.multiply.outer(t, k)
    q = np.sin(wave) @ (a / k).T + np.cos(wave) @ (b / k).T
    q *= rng.uniform(0.75, 1.05, 6) / np.ptp(q, axis=0) * np.array([2.0, 1.7, 2.0, 2.1, 2.1, 2.1])
    inside = np.clip(np.minimum(t, 2 * seconds - 0.5 - t) / 1.5, 0.0, 1.0)
    q *= (inside**3 * (10 - 15 * inside + 6 * inside**2))[:, None]
    fastest = np.abs(np.gradient(q, period, axis=0)).max(axis=0)
    q *= np.minimum(1.0, speed * np.array([1.2, 1.2, 1.5, 1.9, 1.9, 1.9]) / fastest)
    dq = np.gradient(q, period, axis=0)
    return Reference(home + q, dq, np.gradient(dq, period, axis=0), period)


def _to_and_fro(seconds: float, ramp: float, period: float) -> np.ndarray:
    """Speed profile 0, 1 for `seconds`, -1 for `seconds`, 0, joined by half cosines of `ramp` s."""
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(round(ramp / period)) + 0.5) * period / ramp)
    flat = np.ones(round(seconds / period))
    turn = 1.0 - 2.0 * rise
    return np.concatenate([rise, flat, turn, -flat, -rise[::-1]])


def _chirp(rng: np.random.Generator, speed: float, period: float, seconds: float = 11.0) -> np.ndarray:
    """Speeds (K, 6) of a chirp that ends at rest, with its own phase and rate at each joint."""
    t = np.arange(round(seconds / period)) * period
    rate = rng.uniform(0.9, 1.1, 6)
    sweep = np.log(14.0)
    phase = 2 * np.pi * 0.5 * seconds / sweep * np.expm1(t / seconds * sweep)[:, None] * rate
    fade = np.clip(np.minimum(t, seconds - t) / 1.0, 0.0, 1.0)[:, None]
    size = speed * rng.uniform(0.12, 0.22, 6)
    return size * fade**2 * (3 - 2 * fade) * np.sin(phase + rng.uniform(0, 2 * np.pi, 6))


def _integrated(home: np.ndarray, dq: np.ndarray, period: float) -> Reference:
    q = home + np.cumsum(dq, axis=0) * period
    return Reference(q, dq, np.gradient(dq, period, axis=0), period)
