"""A tone: torque at one frequency in every recording, whatever the motion (mains pick-up, a fan, another machine).

P is the Hann-windowed periodogram of one joint's residual, and P_0 its median within NEAR of a frequency, over ln 2. For noise
P / P_0 is exponential with mean 1, so 2 P / P_0 is chi-square with two degrees of freedom. Over recordings these add, since the
phases are free. The largest over all frequencies is tested (R. A. Fisher 1929, doi:10.1098/rspa.1929.0151), with the local
median as the noise because residuals are coloured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import median_filter

from calib.diagnosis.model import LogModel

LOWEST, NEAR = 0.5, 0.5  # Hz; below LOWEST lie the slow errors of every model
LEAST_ROWS = 100


@dataclass(frozen=True)
class Tone:
    """gains (L,) of the recordings, each chi-square with two degrees of freedom without a tone; amplitude N m."""

    frequency: float
    gains: tuple[float, ...]
    amplitude: float


def strongest(models: Sequence[LogModel], residuals: Sequence[np.ndarray], j: int, fitted: int) -> Tone | None:
    """The frequency with the largest sum of gains over the first `fitted` recordings; residuals (R,) N m per recording.

    The residuals are of all rows. Frequencies that a periodic motion itself excites are left out. None with fewer than two
    recordings: the harmonics of one motion cannot be distinguished from a tone.
    """
    usable = [(m, e) for m, e in zip(models, residuals, strict=True) if m.measurement.row_usable[:, j].sum() >= LEAST_ROWS]
    if len(usable) < 2 or len(usable) < len(models):
        return None
    step = 1.0 / max(m.measurement.rate for m, _ in usable)
    count = next_fast_len(2 * int(max(_seconds(m)[-1] for m, _ in usable) / step), real=True)
    highest = min(m.measurement.decimator.cutoff for m, _ in usable)
    frequency = np.arange(count // 2 + 1) / (count * step)
    band = (frequency > LOWEST) & (frequency < highest)
    if band.sum() < 3:
        return None
    spectra = [_gains(m, e, j, step, count, frequency) for m, e in usable]
    total = np.sum([gain for gain, _ in spectra[:fitted]], axis=0)
    for m, _ in usable:
        if m.measurement.period is not None:
            harmonic = frequency * m.measurement.period
            band &= np.abs(harmonic - np.round(harmonic)) > 1.5 * m.measurement.period / (_seconds(m)[-1])
    if not band.any():
        return None
    k = int(np.argmax(np.where(band, total, -np.inf)))
    return Tone(
        float(frequency[k]), tuple(float(gain[k]) for gain, _ in spectra), float(np.mean([size[k] for _, size in spectra]))
    )


def _gains(m: LogModel, e: np.ndarray, j: int, step: float, count: int, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """2 P / P_0 and the amplitude N m of a sine, per frequency."""
    usable = m.measurement.row_usable[:, j]
    at = _seconds(m)[usable]
    at = at - at[0]
    window = 1.0 - np.cos(2 * np.pi * at / max(at[-1], 1e-9))
    series = np.zeros(count)
    series[np.round(at / step).astype(int)] = (e[usable] - e[usable].mean()) * window
    spectrum = np.abs(rfft(series))
    width = 2 * max(1, int(NEAR / (frequency[1] - frequency[0]))) + 1
    floor = median_filter(spectrum**2, width, mode="nearest") / np.log(2)
    return 2 * spectrum**2 / np.maximum(floor, 1e-300), 2 * spectrum / max(float(window.sum()), 1e-300)


def _seconds(m: LogModel) -> np.ndarray:
    """(R,) s of the rows since the log's first sample, gaps included."""
    return np.asarray(m.link.t[m.measurement.row_samples] - m.link.t[0])
