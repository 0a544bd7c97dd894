"""From one arm to a fleet: 200 arms killed and resumed; with a command for each, cost over length and the same numbers on every engine.

The recordings are made here. Workers and scheduler share this computer with everything else that runs on it, so CPU time stands
beside wall time. `python -m benchmarks.fleet` has a command for each.
"""

from __future__ import annotations

from typing import Any

from benchmarks.imports import commands
from benchmarks.kept import FOLDER

MEASURES = ("benchmarks.fleet", "benchmarks.fleet.alone", *commands("fleet"))


def run(arms: int = 200, seconds: float = 300.0) -> list[dict[str, Any]]:
    """The whole plant, with its recordings kept under build/: what, value, unit, bar, note."""
    # here, because a measurement in a process of its own is a module of this package too
    from benchmarks.fleet.pace import pace

    return pace(FOLDER / "fleet", arms, seconds)
