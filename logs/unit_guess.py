"""First guess at the unit of a column, from its name and its numbers."""

from __future__ import annotations

import math

import numpy as np

from logs.column_map import Columns
from logs.column_names import stated_unit, unknown_unit
from logs.tables.table import Table
from logs.units import TIME, UNITS
from logs.words import finding, wrapped

TURNS = (2 * math.pi, 25.0)  # rad: a full turn; the range of many CAN drives' position field, -12.5 to 12.5
SAME_SPEED = 0.15  # share by which a speed may be off the derivative of the position
MOVES = 0.02  # rad/s in the median
FOLLOWS = 0.9  # correlation of a position with the integral of its speed; 0.98 and more in benchmarks/real_sets.py, wrapped ones left out
TURNING_SPEED = 100.0  # rad/s: a faster step of the position is not motion


def unit_of(table: Table, channel: str, columns: tuple[str, ...], doubts: list[str]) -> str:
    """The unit that the names state, else the one that the size of the numbers suggests."""
    stated = {stated_unit(channel, name) for name in columns if name} - {""}
    unit = next((unit for unit in reversed(UNITS[channel]) if unit in stated), "")
    if len(stated) > 1:
        doubts.append(f"the columns of {channel} state {' and '.join(sorted(stated))}: {unit} is taken for all of them")
    if unit:
        return unit
    unit = next(iter(UNITS[channel]))
    if channel in ("q", "q_cmd"):
        x = np.concatenate([table.columns[name] for name in columns if name])
        x = np.abs(x[np.isfinite(x)])
        reach = float(np.quantile(x, 0.99)) if len(x) else 0.0
        if reach > 6 * math.pi and not any(reach <= turn / 2 * 1.001 for turn in TURNS):
            doubts.append(f"{channel} reaches {reach:.4g}: it is taken as deg")
            unit = "deg"
    text = unknown_unit(channel, columns)
    if text:
        doubts.append(
            f"the unit '{text:.40}' of {', '.join(filter(None, columns))} is not known: {unit} is taken; state it with "
            f"--column {channel}=NAME,NAME,...:UNIT"
        )
    return unit


def time_unit(table: Table, name: str, doubts: list[str]) -> str:
    """The unit that the name of a column of times states, else the one that its steps suggest."""
    unit = stated_unit("time", name)
    if unit:
        return unit
    x = table.columns[name]
    step = float(np.median(np.diff(x[np.isfinite(x)])))
    # arms are recorded at 2 Hz to 5 kHz; the unit that gives such a rate is likely
    unit = next((u for u in ("s", "ms", "us", "ns") if 2e-4 <= step * TIME[u] <= 0.5), "s")
    text = unknown_unit("time", (name,))
    if unit != "s" or text:
        unknown = f", whose unit '{text:.40}' is not known," if text else ""
        doubts.append(f"{name}{unknown} rises by {step:g} a sample: it is taken as {unit}")
    return unit


def integer_unit(table: Table, columns: tuple[str, ...], doubts: list[str]) -> str | None:
    """Integer type (logs.words) of a drive's reading whose sign was lost, or None."""
    for name in filter(None, columns):
        integer = wrapped(table.columns[name])
        if integer is not None:
            doubts.append(f"{name} holds {finding(table.columns[name], integer)}; it is taken as {integer}")
            return integer
    return None


def speeds(table: Table, part: Columns, positions: Columns, t: np.ndarray, rows: np.ndarray, doubts: list[str]) -> Columns:
    """Speeds in the unit that makes them the derivative of the positions, where their names state none."""
    if positions.wraps is not None or any(stated_unit("dq", name) for name in part.columns):
        return part
    rising = np.r_[True, np.diff(t) > 0]  # a stamp printed with too few digits for the rate repeats
    ratios = []
    for of_q, of_dq in zip(positions.columns, part.columns, strict=True):
        if not (of_q in table.columns and of_dq in table.columns):
            continue
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            q, dq = table.columns[of_q][rows][rising] * UNITS["q"][positions.unit], table.columns[of_dq][rows][rising]
            slope = np.diff(q) / np.diff(t[rising])
            ok = np.isfinite(slope) & np.isfinite(dq[1:])
        size = float(np.median(np.abs(slope[ok]))) if ok.any() else 0.0
        if size > MOVES:
            ratios.append(float(np.median(np.abs(dq[1:][ok]))) / size)
    ratio = float(np.median(ratios)) if ratios else 1.0
    likely = next((u for u, factor in UNITS["dq"].items() if abs(ratio * factor - 1) < SAME_SPEED), part.unit)
    if likely != part.unit:
        doubts.append(f"dq is the derivative of q in {likely}: this unit is taken")
        return Columns(part.columns, likely, part.factor, part.wraps, part.integer)
    return part


def turns(table: Table, part: Columns, t: np.ndarray, rows: np.ndarray, doubts: list[str]) -> Columns:
    """The columns, with `wraps` set where a position always jumps by the same angle and covers just that angle."""
    for name in filter(None, part.columns):
        with np.errstate(over="ignore", invalid="ignore"):  # absurd values may overflow
            q = table.columns[name][rows] * UNITS["q"][part.unit]
            ok = np.isfinite(q) & np.isfinite(t)
            step, dt = np.diff(q[ok]), np.diff(t[ok])
            jumps = np.abs(step) > TURNING_SPEED * np.maximum(dt, 1e-9) + 0.5
        if not jumps.any():
            continue
        for turn in TURNS:
            if np.all(np.abs(np.abs(step[jumps]) - turn) < 0.1 * turn) and 0.8 * turn < np.ptp(q[ok]) <= 1.01 * turn:
                doubts.append(f"{name} jumps by {turn:.4g} rad {int(jumps.sum())} times: it is taken to wrap there")
                return Columns(part.columns, part.unit, part.factor, turn)
    return part


def follows(table: Table, position: str, speed: str, t: np.ndarray, rows: np.ndarray) -> bool:
    """Whether a column is the integral of another, up to scale and offset; noise of either hardly changes an integral."""
    with np.errstate(over="ignore", invalid="ignore"):
        q, dq = table.columns[position][rows].astype(float), table.columns[speed][rows].astype(float)
        ok = np.isfinite(q) & np.isfinite(dq) & np.isfinite(t)
        q, dq, t = q[ok], dq[ok], t[ok]
        walked = np.r_[0.0, np.cumsum((dq[1:] + dq[:-1]) / 2 * np.diff(t))] if len(q) else q
        q, walked = q - np.mean(q) if len(q) else q, walked - np.mean(walked) if len(q) else q
        size = float(np.linalg.norm(q) * np.linalg.norm(walked))
        return bool(math.isfinite(size) and size > 0 and float(q @ walked) > FOLLOWS * size)
