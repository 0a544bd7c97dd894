"""Which of an arm's own shapes are never checked against each other, and why: links that share a joint, and shapes that can never part."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim.arm import Arm

POSTURES = 200
# m beyond its margin that a pair must reach somewhere to count as one that can part: links two joints apart, and others
KIN_EXTRA, EXTRA = 0.002, 0.006


def adjacent(parent: np.ndarray, a: int, b: int) -> bool:
    """Whether two links are one, or share a joint; -1 is the base."""
    return a == b or (a >= 0 and int(parent[a]) == b) or (b >= 0 and int(parent[b]) == a)


def postures(arm: Arm) -> np.ndarray:
    """(POSTURES, n) rad drawn over the whole range of the joints, at most a turn of it."""
    low, high = np.where(np.isfinite(arm.q_min), arm.q_min, -np.pi), np.where(np.isfinite(arm.q_max), arm.q_max, np.pi)
    middle, half = (low + high) / 2, np.minimum((high - low) / 2, np.pi)
    return np.asarray(middle + half * np.random.default_rng(0).uniform(-1, 1, (POSTURES, arm.n)))


def never_part(arm: Arm, distances: Callable[[np.ndarray], np.ndarray], margin: np.ndarray) -> dict[int, str]:
    """Index of each pair that keeps its margin (P,) m in none of POSTURES postures -> the reason in words.

    distances(q) gives (P,) m at one posture (n,). Such shapes hold more than the bodies do, or bodies that were built into each other:
    with them no posture of the arm would be free.
    """
    farthest = np.full(len(margin), -np.inf)
    for posture in postures(arm):
        farthest = np.maximum(farthest, distances(posture))
    needed = margin + np.where(margin > 0, EXTRA, KIN_EXTRA)
    return {
        int(k): f"at most {farthest[k] * 1e3:.1f} mm apart in {POSTURES} postures over the whole range: they can never part"
        for k in np.flatnonzero(farthest < needed)
    }
