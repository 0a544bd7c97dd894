"""Which pairs of bodies are looked at in a cycle of the monitor, compiled: every one that may be too near by now."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def to_look_at(q, seen, seen_q, reach, least, turn, looks, asked):  # type: ignore[no-untyped-def]
    """How many pairs' distances are looked at now, and which, in `asked`: those that may be too near by now, and `looks` more in turn.

    seen (P,) m at seen_q (P, n) rad: a pair cannot be nearer now than that less reach (P, n) times what was turned since.
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
    """Keep what was found at q (n,), and which of it is nearest beyond the least that it may be: its place, or -1 where none is too near."""
    worst, place = np.inf, -1
    for k in range(len(found)):
        p = asked[k]
        seen[p], spare = found[k], found[k] - least[p]
        seen_q[p] = q
        if not spare >= min(worst, 0.0):
            worst, place = spare, k
    return place
