"""Which pairs of bodies the monitor checks in a cycle."""

from __future__ import annotations

import numpy as np

from safety import looks


def test_pairs_that_are_far_apart_are_looked_at_in_turn() -> None:
    """Distant pairs take turns, `most` of them per cycle; a pair that may be too near by now is checked in every cycle."""
    pairs, most = 10, 3
    q, seen, reach = np.zeros(2), np.full(pairs, 5.0), np.ones((pairs, 2))
    least, asked = np.full(pairs, 0.1), np.zeros(pairs, dtype=np.int64)
    turns = [
        asked[: looks.to_look_at(q, seen, np.zeros((pairs, 2)), reach, least, turn, most, asked)].tolist() for turn in range(4)
    ]
    assert turns == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [0, 1, 9]]
    seen[7] = 0.05
    assert asked[: looks.to_look_at(q, seen, np.zeros((pairs, 2)), reach, least, 0, most, asked)].tolist() == [0, 1, 2, 7]
