"""From one arm to a fleet: an hour in seconds, cost over length, arms a minute on two engines, a worker killed in the middle.

The recordings are made here. Workers and scheduler share this computer with everything else that runs on it, so CPU time stands
beside wall time. `python -m benchmarks.fleet` has a command for each.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def run(
    arms: int = 12, seconds: float = 300.0, minutes: Sequence[float] = (1.0, 3.0, 10.0, 30.0, 60.0)
) -> list[dict[str, Any]]:
    """All figures, with few arms: what, value, unit, bar, note."""
    # here, because a measurement in a process of its own is a module of this package too
    from benchmarks.fleet.length import length
    from benchmarks.fleet.pace import pace
    from benchmarks.fleet.same import same

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        return length(folder, minutes) + pace(folder, arms, seconds) + same(folder, min(arms, 8), seconds)
