"""Speed from positions, for drives whose own speed field is too coarse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

WINDOW_MAX = 0.1  # s; a longer window looks back too far


def end_slope_gain(samples: int) -> float:
    """Standard deviation of the end slope of a parabola fitted to `samples` equidistant points, for unit noise and spacing."""
    i = np.arange(samples) - (samples - 1.0)
    return float(np.linalg.norm(np.linalg.pinv(np.stack([np.ones(samples), i, i * i], axis=1))[1]))


def window_for(q_step: float, dq_step: float, rate: float) -> int:
    """The shortest window, samples, whose quantisation noise is below that of the speed field; 0 if the field is better.

    gain(M) q_step rate <= dq_step, both divided by sqrt(12); q_step rad, dq_step rad/s, rate Hz. A step of 0 is a float.
    """
    if dq_step == 0.0:
        return 0
    for samples in range(5, int(WINDOW_MAX * rate) + 1, 2):
        if end_slope_gain(samples) * q_step * rate <= dq_step:
            return samples
    return 0


class Differentiator:
    """dq(t_k) = slope at t_k of the parabola fitted to the last M positions; exact for constant acceleration.

    A position unchanged for a time T bounds |dq| to q_step / T: a joint stopped by dry friction stands at once, while the parabola would
    show a speed for the rest of its window.
    """

    def __init__(self, samples: int, q_step: float) -> None:
        self.samples, self._q_step = samples, q_step
        self._t: list[float] = []
        self._q: list[float] = []

    def __call__(self, t: float, q: float) -> float:
        """The speed at the newest sample, rad/s; NaN for fewer than three samples. t s, strictly increasing, q rad."""
        self._t = [*self._t[-self.samples + 1 :], t]
        self._q = [*self._q[-self.samples + 1 :], q]
        if len(self._t) < 3:
            return float("nan")
        x = np.array(self._t) - t
        slope = float(np.linalg.lstsq(np.stack([np.ones_like(x), x, x * x], axis=1), np.array(self._q) - q, rcond=None)[0][1])
        stood = t - next((a for a, b in zip(reversed(self._t[1:]), reversed(self._q[:-1]), strict=True) if b != q), self._t[0])
        if stood <= 0:
            return slope
        most = self._q_step / stood
        return max(-most, min(most, slope))


class Speeds:
    """dq (n,) of a whole arm: each joint's from its positions, or from the drive's own field where that is finer.

    steps: (q_step rad, dq_step rad/s) of each joint; windows: samples that each joint looks back over, 0 for the field.
    """

    def __init__(self, steps: Sequence[tuple[float, float]], rate: float) -> None:
        self.windows = [window_for(q, dq, rate) for q, dq in steps]
        self._each = [Differentiator(w, q) if w else None for w, (q, _) in zip(self.windows, steps, strict=True)]

    def __call__(self, t: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """(n,) rad/s of the reading at t s, from positions q (n,) rad and the drives' own speeds dq (n,) rad/s."""
        found = dq.copy()
        for j, differentiator in enumerate(self._each):
            if differentiator is not None and not np.isnan(slope := differentiator(t, float(q[j]))):
                found[j] = slope
        return found

    @property
    def source(self) -> str:
        """Where the speeds come from, in words."""
        return "from " + " and ".join(
            sorted({f"positions over {w} samples" if w else "the drives' field" for w in self.windows})
        )
