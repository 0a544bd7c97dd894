"""Samples of a recording that are left out, and why: standing joints, ends, clipped and flat readings."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from logs.log import Log

STANDING_SECONDS = 0.3
# A pause between two motions is shorter (1.0 to 1.5 s in the recordings of a UR10e); a sweep of one joint holds the others for longer
PAUSE_SECONDS = 2.0
FLAT_SAMPLES = 3


@dataclass(frozen=True)
class Exclusion:
    """What was left out, and why: seconds of the log, of one joint or of all (None)."""

    joint: str | None
    reason: str
    seconds: float


def standing_samples(still: np.ndarray, starts: np.ndarray, rate: float, seconds: float = STANDING_SECONDS) -> np.ndarray:
    """(N, n) whether a joint stands for `seconds` or longer: its torque may then be anywhere within its dry friction."""
    shortest = int(seconds * rate)
    out = np.zeros_like(still)
    for j in range(still.shape[1]):
        edge = np.flatnonzero(np.diff(still[:, j])) + 1
        runs = np.unique(np.concatenate([[0], edge, starts[1:-1], [len(still)]]))
        for lo, hi in itertools.pairwise(runs):
            out[lo:hi, j] = still[lo, j] and hi - lo >= shortest
    return out


def ends_of_motion(standing: np.ndarray) -> np.ndarray:
    """(N,) samples before the first and after the last motion of any joint."""
    moving = np.flatnonzero(~standing.all(axis=1))
    out = np.ones(len(standing), dtype=bool)
    if len(moving):
        out[moving[0] : moving[-1] + 1] = False
    return out


def clipped_samples(tau: np.ndarray, tau_max: np.ndarray) -> np.ndarray:
    """(N, n) readings at the torque limit, and flat tops: FLAT_SAMPLES or more equal extreme readings of either sign."""
    out = np.abs(tau) >= 0.999 * np.where(np.isfinite(tau_max), tau_max, np.inf)
    for j in range(tau.shape[1]):
        x = np.where(np.isfinite(tau[:, j]), tau[:, j], 0.0)
        for sign in (1.0, -1.0):
            top = (sign * x).max()
            at_top = (top > 0) & (sign * x >= top * (1 - 1e-9))
            together = np.convolve(at_top, np.ones(FLAT_SAMPLES), mode="same") >= FLAT_SAMPLES
            if together.any():
                out[:, j] |= at_top
    return out


def listed_exclusions(
    joints: tuple[str, ...], rate: float, usable: np.ndarray, ends: np.ndarray, standing: np.ndarray, clipped: np.ndarray
) -> list[Exclusion]:
    exclusions = [Exclusion(None, "standing ends", float(ends.sum()) / rate)] if ends.any() else []
    for j, joint in enumerate(joints):
        for mask, reason in (
            (standing[:, j] & ~ends, "standing"),
            (clipped[:, j] & ~ends, "torque at its limit"),
            (~usable[:, j] & ~ends & ~clipped[:, j], "window reaches past an end, or no reading"),
        ):
            if mask.any():
                exclusions.append(Exclusion(joint, reason, float(mask.sum()) / rate))
    return exclusions


def names_of(log: Log, which: np.ndarray) -> str:
    return ", ".join(j for j, w in zip(log.joint_names, which, strict=True) if w)
