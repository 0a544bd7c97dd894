"""Checks of a recording's time: its rate, its unit and missing samples."""

from __future__ import annotations

import math

import numpy as np

from calib.gate.check import Cause, GateCheck
from calib.gate.correction import UNITS, Correction
from calib.gate.fit import LEAST_ROWS
from calib.gate.readings import name_of
from logs.clock_steps import set_forward
from logs.log import Log
from logs.lost_time import finding, lost_time
from logs.timing import GAP_FACTOR, coarse, finer

STEP_LEAST, STEP_MOST = 1e-4, 0.2  # s between samples: 10 kHz and 5 Hz
USUAL_LEAST, USUAL_MOST = 1 / 5000, 1 / 12
MOST_LOST = 0.3


def clock(log: Log) -> GateCheck:
    """The rate is between 5 Hz and 10 kHz, and the stamps distinguish the samples."""
    name = name_of(log)
    step = np.diff(log.t[np.isfinite(log.t)])
    short = GateCheck("clock", False, f"{name}: {len(step) + 1} samples with a time", (Cause("the recording is too short"),))
    unresolved = coarse(log.t, log.q, log.dq, log.tau, log.current)
    if unresolved:
        return GateCheck(
            "clock", False, f"{name}: {unresolved}", (Cause(f"stamps that were rounded; {finer(log.metadata)}"),), final=True
        )
    if not (step > 0).any():
        return short
    if np.any(step < 0):
        at = int(np.argmax(step < 0))
        cause = Cause("time runs backwards: two recordings in one file, or a clock that was set")
        return GateCheck(
            "clock", False, f"{name}: sample {at + 1} is {-step[at]:.4g} s earlier than the one before it", (cause,), final=True
        )
    middle = float(np.median(step[step > 0]))
    if STEP_LEAST <= middle <= STEP_MOST:
        return short if len(step) < 16 else GateCheck("clock", True, f"{name}: {1 / middle:.4g} Hz")
    moved = _elapsed(log)
    causes = []
    for unit, factor in UNITS["t"].items():
        if factor != 1 and USUAL_LEAST <= middle * factor <= USUAL_MOST:
            gain = -abs(math.log(moved / (middle * factor))) if moved else -1.0
            causes.append(Cause(Correction("unit", "t", unit=unit).sentence(()), gain, (Correction("unit", "t", unit=unit),)))
    causes.sort(key=lambda cause: -cause.gain)
    return GateCheck(
        "clock", False, f"{name}: a sample every {middle:.4g} s; arms are recorded at 5 Hz to 10 kHz", tuple(causes[:2])
    )


def _elapsed(log: Log) -> float | None:
    """Seconds between samples from the change of q over dq; None where there are too few of both."""
    moved, speed = np.diff(log.q, axis=0), 0.5 * (log.dq[1:] + log.dq[:-1])
    ok = np.isfinite(moved) & np.isfinite(speed) & (np.abs(speed) > 0.3 * np.nanmax(np.abs(speed), initial=1e-9))
    ratio = moved[ok] / speed[ok]
    return float(np.median(ratio)) if len(ratio) > LEAST_ROWS and np.median(ratio) > 0 else None


def losses(log: Log) -> GateCheck:
    """Less than MOST_LOST of the samples is missing. Samples lost under an even clock are reported but not refused: see logs.lost_time."""
    step = np.diff(log.t)
    period = float(np.median(step[step > 0]))
    gaps = np.flatnonzero(step > GAP_FACTOR * period)
    step[gaps] -= set_forward(log.t, log.q, log.dq, gaps)
    share = 1 - len(log) / max(1.0, step.sum() / period + 1)
    detail = f"{name_of(log)}: {max(share, 0.0):.1%} of the samples missing, longest gap {step.max():.3g} s"
    finite = np.isfinite(log.q).all(axis=1)
    unseen = finding(lost_time(log.t[finite], log.q[finite], log.dq[finite]))
    detail += f"; {unseen}. Speeds leave these steps out, and no simulation runs over them" if unseen else ""
    return GateCheck("losses", share < MOST_LOST, detail, () if share < MOST_LOST else (Cause("samples were lost"),))
