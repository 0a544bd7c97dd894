"""Designing the excitation: how long eight starts take, and what they reach."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from calib.excitation.design import Information, coarse, noise_of, random_start
from calib.excitation.fourier import Basis
from calib.excitation.optimise import descended, optimised
from calib.excitation.room import Room
from calib.excitation.session import cleared_fourier, home_of, open_cell
from calib.identification.model import TorqueModel
from sim.arm import load_arm


def run() -> list[dict[str, Any]]:
    """UR10e, one period of 20 s, 6 harmonics: 60 free coefficients."""
    arm = load_arm("ur10e")
    cell, model, basis = open_cell(arm), TorqueModel.of_arm(arm), Basis(6, 20.0)
    room, information, rng = Room(arm, cell), Information(model, noise_of(model)), np.random.default_rng(0)
    home = home_of(room, cell, None, rng)
    best, random = random_start(room, information, basis, home, rng, 100)
    began = time.perf_counter()
    found = optimised(arm, cell, best, 8, 0, lambda stage, share: None)
    wall = time.perf_counter() - began
    seconds = sum(s.seconds for s in found)
    _, kept = cleared_fourier(found[0].motion, arm, cell, 500.0, 1)
    worth = information.worth(coarse(kept))
    free = max(descended(arm, cell, s.motion, None, capped=False).worth.log_det for s in found[:2])
    return [
        _row("eight starts, 2 processes, wall", wall, "s", "<= 60"),
        _row("eight starts, CPU of the descents", seconds, "s", "", f"{seconds / 8:.1f} s a start; single thread each"),
        _row("condition number (base, raw SI) after safety.clear", worth.condition, "", "<= 40", f"best of 100 random: {random.condition:.0f}"),
        _row("log det after safety.clear", worth.log_det, "nats", "", f"best of 100 random: {random.log_det:.0f}"),
        _row("log det short of the best without a cap on the condition number", free - worth.log_det, "nats", "<= 10",
             "that best: two further descents without the cap, from the two best ends"),
    ]  # fmt: skip


def _row(what: str, value: float, unit: str, bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": f"{value:.3g}", "unit": unit, "bar": bar, "note": note}
