"""Selects the pairs of bodies whose distance a monitor cycle computes: all that may be too close by now. Compiled."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def to_look_at(q, seen, seen_q, reach, least, turn, looks, asked):  # type: ignore[no-untyped-def]
    """Number of pairs whose distance is computed now, listed in `asked`: those that may be too close, and `looks` more in turn.

    seen (P,) m was the distance at seen_q (P, n) rad. It is now at least seen less reach (P, n) times the turn since then.
    """
    count, pairs = 0, len(seen)
    for p in range(pairs):
        bound = seen[p]
        for j in range(len(q)):
            bound -= reach[p, j] * abs(q[j] - seen_q[p, j])
        in_turn = (p - turn * looks) % pairs < looks
        if in_turn or not bound >= least[p]:
            asked[count] = p
            count += 1
    return count


@numba.njit(cache=True)
def nearest(q, found, asked, seen, seen_q, least):  # type: ignore[no-untyped-def]
    """Store the distances found at q (n,); return the index of the pair furthest below its least distance, or -1 if none is."""
    worst, place = np.inf, -1
    for k in range(len(found)):
        p = asked[k]
        seen[p], spare = found[k], found[k] - least[p]
        seen_q[p] = q
        if not spare >= min(worst, 0.0):
            worst, place = spare, k
    return place
