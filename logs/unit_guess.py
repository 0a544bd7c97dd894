"""A first guess at the unit of a column, from its name and its numbers."""

from __future__ import annotations

import math
import re

import numpy as np

from logs.column_map import Columns
from logs.tables.table import Table
from logs.units import TIME, UNITS
from logs.words import finding, wrapped

UNIT_WORDS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "rpm": "rpm", "ms": "ms", "us": "us", "ns": "ns", "ma": "mA",
    "nmm": "N mm", "mnm": "mN m", "nm": "N m", "amp": "A", "rev": "rev", "celsius": "degC", "k": "K", "s": "s", "a": "A", "c": "degC",
}  # fmt: skip
# as they stand in brackets, without blanks and signs of multiplication
WRITTEN = {
    **{unit.replace(" ", ""): unit for channel in UNITS.values() for unit in channel},
    **{unit: unit for unit in TIME}, "°": "deg", "°/s": "deg/s", "degree": "deg", "degrees": "deg", "degrees/s": "deg/s", "°C": "degC",
    "C": "degC", "Amp": "A",
}  # fmt: skip
TURNS = (2 * math.pi, 25.0)  # rad: a full turn; the range of many CAN drives' position field, -12.5 to 12.5
SAME_SPEED = 0.15  # share by which a speed may be off the derivative of the position
MOVES = 0.02  # rad/s in the median
TURNING_SPEED = 100.0  # rad/s: beyond it a step of the position is no motion


def unit_of(table: Table, channel: str, columns: tuple[str, ...], doubts: list[str]) -> str:
    """The unit that the names state, else the one that the size of the numbers makes likely."""
    stated = {UNIT_WORDS[w] for name in columns for w in words_of(name)[1:] if w in UNIT_WORDS} | set(map(unit_behind, columns))
    own = next(iter(UNITS[channel]))
    if "dps" in {w for name in columns for w in words_of(name)} or ("deg" in stated and channel.startswith("dq")):
        stated.add("deg/s")
    fits = [unit for unit in UNITS[channel] if unit in stated and unit != own]
    if fits:
        return fits[0]
    if channel in ("q", "q_cmd") and own not in stated:
        x = np.concatenate([table.columns[name] for name in columns if name])
        x = np.abs(x[np.isfinite(x)])
        reach = float(np.quantile(x, 0.99)) if len(x) else 0.0
        if reach > 6 * math.pi and not any(reach <= turn / 2 * 1.001 for turn in TURNS):
            doubts.append(f"{channel} reaches {reach:.4g}: it is taken as deg")
            return "deg"
    return own


def integer_unit(table: Table, columns: tuple[str, ...], doubts: list[str]) -> str | None:
    """The word whose sign a drive's reading has lost."""
    for name in filter(None, columns):
        integer = wrapped(table.columns[name])
        if integer is not None:
            doubts.append(f"{name} holds {finding(table.columns[name], integer)}; it is taken as {integer}")
            return integer
    return None


def speeds(
    table: Table, part: Columns, positions: Columns, time: str, unit: str, rows: np.ndarray, doubts: list[str]
) -> Columns:
    """Speeds in the unit in which they are the derivative of the positions, where their names state none."""
    if positions.wraps is not None or any(
        unit_behind(name) or any(word in UNIT_WORDS for word in words_of(name)[1:]) for name in part.columns
    ):
        return part
    t = table.columns[time].astype(float)[rows] * TIME[unit]
    ratios = []
    for of_q, of_dq in zip(positions.columns, part.columns, strict=True):
        if not (of_q and of_dq):
            continue
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            q, dq = table.columns[of_q][rows] * UNITS["q"][positions.unit], table.columns[of_dq][rows]
            slope = np.diff(q) / np.diff(t)
            ok = np.isfinite(slope) & np.isfinite(dq[1:])
        size = float(np.median(np.abs(slope[ok]))) if ok.any() else 0.0
        if size > MOVES:
            ratios.append(float(np.median(np.abs(dq[1:][ok]))) / size)
    ratio = float(np.median(ratios)) if ratios else 1.0
    likely = next((u for u, factor in UNITS["dq"].items() if abs(ratio * factor - 1) < SAME_SPEED), part.unit)
    if likely != part.unit:
        doubts.append(f"dq is the derivative of q in {likely}: it is taken as that")
        return Columns(part.columns, likely, part.factor, part.wraps, part.integer)
    return part


def turns(table: Table, part: Columns, time: str, unit: str, rows: np.ndarray, doubts: list[str]) -> Columns:
    """A position that jumps by one and the same angle, and covers just that angle, starts again after it."""
    t = table.columns[time].astype(float)[rows] * TIME[unit]
    for name in filter(None, part.columns):
        with np.errstate(over="ignore", invalid="ignore"):  # values beyond all measure are no readings
            q = table.columns[name][rows] * UNITS["q"][part.unit]
            ok = np.isfinite(q) & np.isfinite(t)
            step, dt = np.diff(q[ok]), np.diff(t[ok])
            jumps = np.abs(step) > TURNING_SPEED * np.maximum(dt, 1e-9) + 0.5
        if not jumps.any():
            continue
        for turn in TURNS:
            if np.all(np.abs(np.abs(step[jumps]) - turn) < 0.1 * turn) and 0.8 * turn < np.ptp(q[ok]) <= 1.01 * turn:
                doubts.append(f"{name} jumps by {turn:.4g} rad {int(jumps.sum())} times: it is taken to start again there")
                return Columns(part.columns, part.unit, part.factor, turn)
    return part


def unit_behind(name: str) -> str:
    """The unit in brackets at the end of a column's name, as in `q1 [deg]` and `speed 2 (°/s)`; "" where there is none."""
    inside = re.search(r"[\[(]([^\[(]*)[\])]$", name)
    return WRITTEN.get(re.sub(r"[\s*·.]", "", inside[1]), "") if inside else ""


def words_of(name: str) -> list[str]:
    """`actual_q_0` -> actual q 0; `jointPos[2]` -> joint pos 2."""
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()
    return re.findall(r"[a-z]+|\d+", split)
