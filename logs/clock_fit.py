"""t_host = offset + (1 + skew) t_device + latency: the fit between the two clocks of a recording.

Latency is never negative and has a long tail, so the line goes through the smallest latencies: the minimum of t_host - t_device
in each of many blocks. It is the Theil-Sen line of these minima, which a third of bad blocks does not move (P. K. Sen 1968,
doi:10.1080/01621459.1968.10480934; the idea of the minima: V. Paxson 1998, doi:10.1145/277851.277865).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from logs.normal import INTERVAL, OF_MEDIAN

BLOCKS = 200
SAMPLES_LEAST = 100
SECONDS_LEAST = 2.0
JUMP_LEAST = 0.005  # s
JUMP_WINDOW = 1.0  # s: a jump is a step of the smallest latency that lasts this long on both sides
SKEW_MAX = 200e-6  # beyond this one of the clocks is wrong; crystals keep within 100 ppm


@dataclass(frozen=True, slots=True)
class ClockFit:
    """t_host = offset + (1 + skew) t_device at the smallest latency; times relative to the log's origins.

    offset, skew   s, 1; skew_std its standard deviation
    residual       s, robust standard deviation of t_host about the line: the jitter of reception
    latency_most   s, 99.9th percentile of the latency above the smallest
    jumps          (device time s, step s) of lasting changes of t_host - t_device; removed before the fit
    """

    offset: float
    skew: float
    skew_std: float
    residual: float
    latency_most: float
    jumps: tuple[tuple[float, float], ...] = ()

    def findings(self) -> tuple[str, ...]:
        """Sentences about jumps and an excessive skew."""
        out = [f"the clocks jumped apart by {step * 1e3:+.1f} ms at {t:.3f} s (host against device)" for t, step in self.jumps]
        if abs(self.skew) > SKEW_MAX + 3 * self.skew_std:
            out.append(
                f"the host clock runs {self.skew * 1e6:+.0f} ppm against the device clock, more than {SKEW_MAX * 1e6:.0f} ppm: "
                "one of them is wrong, and every rate and speed with it; check the device's time base"
            )
        return tuple(out)

    def text(self) -> dict[str, str]:
        """The fit as a metadata record, numbers in full precision."""
        out = {name: repr(float(getattr(self, name))) for name in ("offset", "skew", "skew_std", "residual", "latency_most")}
        return out | {"jumps": repr([list(jump) for jump in self.jumps]), "unit": "s"}


def fit_clocks(t_device: np.ndarray, t_host: np.ndarray) -> ClockFit | None:
    """Fit (N,) times of the same samples on both clocks, s; None where there is too little to fit, or t_host is not finite.

    t_device must not decrease.
    """
    if len(t_device) < SAMPLES_LEAST or not np.isfinite(t_host).all() or not t_device[-1] - t_device[0] >= SECONDS_LEAST:
        return None
    from scipy.stats import theilslopes  # takes a second to load; a recording process must start without it

    starts = np.unique(np.linspace(0, len(t_device), min(BLOCKS, len(t_device) // 10) + 1).astype(int))[:-1]
    slope = 0.0
    for _ in range(2):  # a step is measured over a second, in which the skew alone moves the clocks apart
        apart = t_host - t_device
        jumps = _jumps(t_device, apart - slope * t_device)
        for t, step in jumps:
            apart -= step * (t_device >= t)
        parts = zip(starts, np.split(apart, starts[1:]), strict=True)
        places = np.array([start + int(np.argmin(part)) for start, part in parts])
        line = theilslopes(apart[places], t_device[places], alpha=0.95)
        slope = float(line.slope)
    residual = apart  # in place: an hour's arrays are large
    residual -= line.intercept
    residual -= line.slope * t_device
    middle = float(np.median(residual))
    latency = float(np.percentile(residual, 99.9) - residual.min())
    residual -= middle
    np.abs(residual, out=residual)
    return ClockFit(
        offset=float(line.intercept),
        skew=float(line.slope),
        skew_std=max(float(line.high_slope - line.low_slope) / (2 * INTERVAL), 1e-12),
        residual=OF_MEDIAN * float(np.median(residual, overwrite_input=True)),
        latency_most=latency,
        jumps=tuple(jumps),
    )


def _jumps(t: np.ndarray, apart: np.ndarray) -> list[tuple[float, float]]:
    """Times (s) and steps (s) where the smallest latency of the second after differs from that before by over JUMP_LEAST."""
    rate = (len(t) - 1) / (t[-1] - t[0])
    window = max(5, min(round(JUMP_WINDOW * rate), len(t) // 4))
    from scipy.ndimage import minimum_filter1d

    least = minimum_filter1d(apart, window, origin=0, mode="nearest")
    half, inner = window // 2, len(least) - 2 * window + 1
    step = np.full(len(least), math.nan)  # the second after minus the second before
    step[window : window + inner] = least[half + window : half + window + inner] - least[half : half + inner]
    threshold = max(JUMP_LEAST, 2 * SKEW_MAX * JUMP_WINDOW)
    with np.errstate(invalid="ignore"):
        high = (step > threshold) | (step < -threshold)
    out = []
    for region in np.split(np.flatnonzero(high), np.flatnonzero(np.diff(np.flatnonzero(high)) > 1) + 1):
        if not len(region):
            continue
        # both minima are clean at one end of the region only: the start for a step up, the end for a step down
        size = float(np.median(step[region]))
        k = int(region[0] if size > 0 else region[-1])
        out.append((float(t[k]), float(step[k])))
    return out
