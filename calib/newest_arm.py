"""`latest` as an arm on the command line."""

from __future__ import annotations

from pathlib import Path

from calib.measurement.recordings import latest_arm
from calib.past_runs import LATEST
from calib.terminal import console


def named(arm: str) -> str:
    """`arm`, or the folder that `latest` stands for, which is reported: the newest arm may be another than the operator thinks of."""
    if arm != LATEST or Path(arm).exists():
        return arm
    folder = latest_arm()
    console.warn(f"{LATEST} is {folder}")
    return str(folder)
