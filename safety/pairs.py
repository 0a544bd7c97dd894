"""Which shapes are never checked against each other, and why: on links that share a joint, unable to part, or always apart."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sim.arm import Arm
from sim.postures import POSTURES, postures

MANY_POSTURES = 2000
# m beyond its margin that a pair must reach in some posture to count as able to part: links two joints apart, other links
KIN_EXTRA, EXTRA = 0.002, 0.006
# distances that a proof for every posture may compute
LOOKS = 1500
TURN_DOUBT = 0.06


def adjacent(parent: np.ndarray, a: int, b: int) -> bool:
    """Whether two links are the same or share a joint; -1 is the base."""
    return a == b or (a >= 0 and int(parent[a]) == b) or (b >= 0 and int(parent[b]) == a)


def never_part(
    arm: Arm, distances: Callable[[np.ndarray, list[int]], np.ndarray], margin: np.ndarray, asked: np.ndarray
) -> dict[int, str]:
    """Index of each pair that can never part -> the reason in words. With such shapes no posture of the arm would be free.

    Such a pair keeps its margin (P,) m in none of POSTURES postures. Links two joints apart, whose margin is 0, also count if
    they overlap in most of many more postures and in none reach the distance that a proof needs, `asked` (P,) m. Their shapes
    are larger than the bodies, or the bodies are built into each other. distances(q, pairs) gives (len(pairs),) m at one
    posture (n,).
    """
    every = list(range(len(margin)))
    found = np.array([distances(posture, every) for posture in postures(arm)])
    farthest = found.max(axis=0)
    stuck = farthest < margin + np.where(margin > 0, EXTRA, KIN_EXTRA)
    out = {
        int(k): f"at most {farthest[k] * 1e3:.1f} mm apart in {POSTURES} postures over the whole range: they can never part"
        for k in np.flatnonzero(stuck)
    }
    close = np.flatnonzero(~stuck & (margin == 0) & (farthest < asked + KIN_EXTRA) & (np.median(found, axis=0) <= 0)).tolist()
    if close:
        found = np.array([distances(posture, close) for posture in postures(arm, MANY_POSTURES)])
        for k, apart in zip(close, found.T, strict=True):
            if apart.max() < asked[k] + KIN_EXTRA and np.median(apart) <= 0:
                out[k] = (
                    f"they overlap in {np.mean(apart <= 0):.0%} of {MANY_POSTURES} postures over the whole range and are at most "
                    f"{apart.max() * 1e3:.1f} mm apart, but a motion needs {asked[k] * 1e3:.1f} mm: they can never part"
                )
    return out


def always_apart(arm: Arm, reach: np.ndarray, needed: float, distance: Callable[[np.ndarray], float]) -> str | None:
    """Proof, in words, that two bodies stay `needed` m apart over the whole range of the joints between them; None if it fails.

    Only for pairs that at most two joints move, and no slide. distance(q): theirs, m; reach (n,) m/rad bounds how fast each
    joint changes it.
    """
    moved = np.flatnonzero(reach)
    if len(moved) == 0:
        apart = distance(np.zeros(arm.n))
        return f"always {apart * 1e3:.1f} mm apart" if apart >= needed else None
    if len(moved) > 2 or arm.tree.prismatic[moved].any():
        return None
    lo, hi = np.zeros(arm.n), np.zeros(arm.n)
    lo[moved], hi[moved] = arm.q_min[moved] - TURN_DOUBT, arm.q_max[moved] + TURN_DOUBT
    if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
        return None
    whole = hi - lo > 2 * np.pi
    lo[whole], hi[whole] = -np.pi, np.pi
    todo, least = [(lo, hi)], np.inf
    for _ in range(LOOKS):
        if not todo:
            joints = " and ".join(arm.joint_names[j] for j in moved)
            return f"at least {least * 1e3:.1f} mm apart in every posture of {joints}"
        lo, hi = todo.pop()
        apart = distance((lo + hi) / 2)
        if not apart >= needed:
            return None
        spare = apart - float(reach @ (hi - lo)) / 2
        if spare >= needed:
            least = min(least, spare)
            continue
        j = int(np.argmax(reach * (hi - lo)))
        below, above = hi.copy(), lo.copy()
        below[j] = above[j] = (lo[j] + hi[j]) / 2
        todo += [(lo, below), (above, hi)]
    return None
