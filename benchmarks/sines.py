"""Motions for the safety benchmarks."""

from __future__ import annotations

import numpy as np

from sim.trajectory import Trajectory


def sines(
    home: np.ndarray, duration: float, amplitude: float, step: float = 0.01, harmonics: int = 5, seed: int = 0
) -> Trajectory:
    """Sums of sines about `home` under a window that is at rest at both ends, exact in all derivatives."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, duration, round(duration / step) + 1)[:, None]
    base = 2 * np.pi / min(duration, 10.0)
    x, dx, ddx = (np.zeros((len(t), len(home))) for _ in range(3))
    for k in range(1, harmonics + 1):
        w, phase, size = k * base, rng.uniform(0, 2 * np.pi, len(home)), rng.uniform(0.3, 1.0, len(home)) * amplitude / k
        x += size * np.sin(w * t + phase)
        dx += size * w * np.cos(w * t + phase)
        ddx -= size * w**2 * np.sin(w * t + phase)
    p = np.pi / duration
    a, da, dda = np.sin(p * t) ** 2, p * np.sin(2 * p * t), 2 * p**2 * np.cos(2 * p * t)
    return Trajectory(t[:, 0], home + a * x, da * x + a * dx, dda * x + 2 * da * dx + a * ddx)
