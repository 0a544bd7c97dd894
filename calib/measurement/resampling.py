"""Samples of a recording on uniform grids between its gaps, and the uncertainty that bridged short gaps leave."""

from __future__ import annotations

import itertools

import numpy as np

from logs.bridging import bridging_error

# samples, or s: over a shorter gap, the cubic through the neighbouring samples is as good as a reading (10 Hz, 0.3 rad: 4e-7
# rad over 10 ms)
GAP_STEPS, GAP_SECONDS = 3.5, 0.0101
# samples on either side of an instant. Three follow a motion better between coarse samples (7 Hz sampled at 125 Hz: 5e-5 too
# small, with two 1e-3), but pass more time stamp noise into the derivatives; from FINE Hz on, two are as good (6e-5)
BESIDE, BESIDE_FINE, FINE = 3, 2, 250.0
MOST_LOST = 100  # consecutive samples; a gap of GAP_SECONDS has more only above 10 kHz


def resampled(
    t: np.ndarray, q: np.ndarray, tau: np.ndarray, rate: float, shortest: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Samples on grids of 1/rate between gaps: t, q by a polynomial through its neighbours, tau by linear interpolation.

    Stretches shorter than `shortest` samples are left out. The last two values are the first sample of each stretch and the
    time lost, s.
    """
    beside = BESIDE if rate < FINE else BESIDE_FINE
    edges = [0, *(np.flatnonzero(np.diff(t) > max(GAP_STEPS / rate, GAP_SECONDS)) + 1), len(t)]
    grids, qs, taus, starts = [], [], [], [0]
    for lo, hi in itertools.pairwise(edges):
        count = int((t[hi - 1] - t[lo]) * rate + 1e-6) + 1
        if count < shortest or hi - lo < 2 * beside:
            continue
        grid = t[lo] + np.arange(count) / rate
        grids.append(grid)
        qs.append(_interpolated(t[lo:hi], q[lo:hi], grid, beside))
        taus.append(np.stack([np.interp(grid, t[lo:hi], x) for x in tau[lo:hi].T], axis=1))
        starts.append(starts[-1] + count)
    lost = float(t[-1] - t[0]) - sum(len(g) - 1 for g in grids) / rate
    if not grids:
        return np.zeros(0), q[:0], tau[:0], np.array(starts), lost
    return np.concatenate(grids), np.concatenate(qs), np.concatenate(taus), np.array(starts), max(lost, 0.0)


def bridging_doubt(t: np.ndarray, tau: np.ndarray, at: np.ndarray, rate: float) -> np.ndarray | None:
    """(M, n) (N m)^2 at the instants `at`: g e_g^2 where g consecutive samples were lost, 0 elsewhere; None where none was.

    e_g is the error of bridging g samples that were recorded, including their own noise. It is the same error over the whole
    gap, so samples that count as independent need g times its variance each.
    """
    lost = np.rint(np.diff(t) * rate).astype(int) - 1
    lost[lost > MOST_LOST] = 0
    if not len(at) or not (lost > 0).any():
        return None
    known = np.isfinite(tau).all(axis=1)
    error = bridging_error(t[known], {"tau": tau[known]}, np.zeros(int(known.sum()), dtype=bool), int(lost.max()), False)["tau"]
    # a gap is no more certain than a shorter one; one too wide to be tried, no more than the widest that could be
    error = np.maximum.accumulate(np.where(np.isfinite(error), error, 0.0), axis=0)
    step = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(lost) - 1)
    g = np.where((at > t[step] + 0.01 / rate) & (at < t[step + 1] - 0.01 / rate), lost[step], 0)
    return np.asarray(g[:, None] * error[g] ** 2)


def _interpolated(t: np.ndarray, x: np.ndarray, at: np.ndarray, beside: int) -> np.ndarray:
    """Lagrange polynomial through `beside` samples before and after each instant of `at`; x (N, n)."""
    first = np.clip(np.searchsorted(t, at, side="right") - beside, 0, len(t) - 2 * beside)
    nodes = [t[first + i] for i in range(2 * beside)]
    out = np.zeros((len(at), x.shape[1]))
    for i, own in enumerate(nodes):
        weight = np.ones(len(at))
        for other in nodes[:i] + nodes[i + 1 :]:
            weight *= (at - other) / (own - other)
        out += weight[:, None] * x[first + i]
    return out
