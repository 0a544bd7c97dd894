"""A plant of a few arms: synthetic recordings that state their arm, cell and serial number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.convert import write_log
from logs.log import Log
from sim.arm import Arm
from tests.calib.conftest import fourier_motion, recorded, varied

START, DAY = 1_767_225_600, 86_400  # 2026-01-01


def write_recording(
    file: Path,
    arm: Arm,
    truth: Arm,
    seed: int,
    motion: str = "excitation",
    day: float = 0.0,
    seconds: float = 12.0,
    still: bool = False,
) -> Path:
    """Write a finished recording of `truth` that states `arm` and the cell of its folder's name."""
    log = recorded(truth, fourier_motion(arm, seed, seconds, 125.0), seed)
    if still:
        q = log.q.copy()
        q[:, 4] = q[0, 4]
        log = replace(log, q=q)
    return write_words(file, arm, log, motion, day)


def write_words(file: Path, arm: Arm, log: Log, motion: str, day: float) -> Path:
    """Write the log as a finished recording that states its arm, cell and serial number."""
    words = {
        "arm": arm.name, "arm_sha256": arm.sha256, "cell": file.parent.name, "serial": f"S-{file.parent.name}", "motion": motion,
        "end_reason": "completed", "wall_clock_start_ns": str(round((START + day * DAY) * 1e9)),
    }  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    write_log(log, file, "clean", words)
    return file


def spoil(file: Path) -> Path:
    """Invert one byte, at a third of the file."""
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 0xFF
    file.write_bytes(bytes(data))
    return file


@pytest.fixture
def plant(tmp_path: Path, ur5e: Arm) -> Path:
    """Five arms with two recordings each, one with a still joint, one damaged, one unknown, and a junk file."""
    folder = tmp_path / "plant"
    for k in range(5):
        truth = varied(ur5e, k + 1)
        write_recording(folder / f"cell-{k}" / "excitation.mcap", ur5e, truth, k)
        write_recording(folder / f"cell-{k}" / "validation.mcap", ur5e, truth, k + 7, "validation", seconds=6.0)
    write_recording(folder / "still" / "a.mcap", ur5e, ur5e, 1, still=True)
    spoil(write_recording(folder / "bad" / "a.mcap", ur5e, ur5e, 1))
    write_recording(folder / "unknown" / "a.mcap", replace(ur5e, name="nobodys"), ur5e, 1)
    (folder / "junk.mcap").write_bytes(b"not a recording")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
