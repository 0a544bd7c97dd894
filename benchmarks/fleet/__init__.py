"""From one arm to a fleet: 200 arms, killed and resumed. Separate commands: cost over length, equal results on every engine.

The recordings are made here. Workers and scheduler share this computer with everything else that runs on it, so CPU time is
given beside wall time. `python -m benchmarks.fleet` has a command for each part.
"""

from __future__ import annotations

from typing import Any

from benchmarks.imports import commands
from benchmarks.kept import FOLDER

MEASURES = ("benchmarks.fleet", "benchmarks.fleet.alone", *commands("fleet"))


def run(arms: int = 200, seconds: float = 300.0) -> list[dict[str, Any]]:
    """The whole plant, with its recordings kept under build/: what, value, unit, bar, note."""
    # imported here: `fleet.alone`, which measures its own process, loads this package too
    from benchmarks.fleet.pace import pace

    return pace(FOLDER / "fleet", arms, seconds)
