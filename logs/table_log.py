"""The recording in a table, read by its column map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.column_map import DRIVE, ColumnMap
from logs.damage import Damage
from logs.log import CHANNELS, MEASURED, Log, State
from logs.plausible import UNIT, bad_samples, first_fault
from logs.tables.table import IN_WORDS, INSTANTS, Table
from logs.timing import COLUMN_MAP, checked_times
from logs.units import TEMPERATURE_ZERO, TIME, UNITS
from logs.words import finding, signed, wrapped
from sim.resources import nearest


def log_of_table(table: Table, columns: ColumnMap, path: Path, damage: Damage) -> Log:
    """Return the recording in a table.

    BadLog names row, column, value and rule of the first bad value; where a partial file is accepted, findings state what was
    left out.
    """
    rows = np.ones(len(table), dtype=bool)
    for name, value in columns.where.items():
        rows &= _column(table, name, damage) == value
    if not rows.any():
        raise damage.refuse("rows", f"none with {dict(columns.where)}", "choose another recording of the file")
    place = table.rows[rows]
    n = len(columns.joints)
    seconds, origin, stamped = _instants(table, columns, rows, damage)
    values: dict[str, np.ndarray] = {}
    for name, part in columns.channels.items():
        scale, zero = UNITS[name][part.unit], TEMPERATURE_ZERO[part.unit] if name == "temperature" else 0.0
        values[name] = np.full((int(rows.sum()), n), np.nan)
        for j, column in enumerate(part.columns):
            if column:
                raw = _column(table, column, damage)[rows]
                if part.integer is not None:
                    raw = signed(raw, part.integer)
                elif name in DRIVE:
                    _require_signed(name, column, raw, damage)
                values[name][:, j] = (raw - zero) * scale * part.factor[j]
        if part.wraps is not None:
            _unwrap(values[name], part.wraps, damage)
    measured = {name: values[name] for name in MEASURED if name in values}
    keep = stamped & _sound(seconds, measured, stamped, place, columns, damage)
    if keep.sum() < 2:
        raise damage.refuse("rows", f"{int(keep.sum())} sound samples", "check the column map, or record it again")
    seconds = seconds[keep]
    shift = seconds[0]
    nothing = np.broadcast_to(np.float64(np.nan), (len(seconds), n))
    q, dq, tau, current, temperature, q_cmd, dq_cmd, tau_cmd = (
        values[name][keep] if name in values else nothing for name in CHANNELS
    )
    seconds, _ = checked_times(seconds - shift, nothing[:, 0], damage, (q, dq))
    about = {"format": table.about, COLUMN_MAP: columns.text()}
    return Log(
        columns.joints, seconds, nothing[:, 0], q, dq, tau, current, temperature, q_cmd, dq_cmd, tau_cmd, about, (),
        damage.all_findings(), path, State.CUT if damage.count else State.UNSTATED, None, max(origin + round(float(shift) * 1e9), 0),
    )  # fmt: skip


def _require_signed(channel: str, column: str, raw: np.ndarray, damage: Damage) -> None:
    integer = wrapped(raw)
    if integer is not None:
        raise damage.refuse(
            f"column {column!r:.80}", finding(raw, integer),
            f'import it with --assume {channel}={integer}, or with integer = "{integer}" under [{channel}] in the column map',
        )  # fmt: skip


def _column(table: Table, name: str, damage: Damage, instants: bool = False) -> np.ndarray:
    if name in table.columns:
        return table.columns[name]
    kind = IN_WORDS if name in table.words else "is not in the file"
    remedy = INSTANTS if instants and name in table.words else nearest(name[:80], list(table.columns)[:40])
    raise damage.refuse(f"column {name!r:.80}", kind, remedy)


def _instants(
    table: Table, columns: ColumnMap, rows: np.ndarray, damage: Damage
) -> tuple[np.ndarray, int, np.ndarray]:  # fmt: skip
    """Seconds from the first row with a time, that time in ns, and which rows have a time."""
    if columns.time is None:
        return np.arange(int(rows.sum())) / float(columns.rate or 1), 0, np.ones(int(rows.sum()), dtype=bool)
    raw = _column(table, columns.time, damage, instants=True)[rows]
    if raw.dtype.kind == "i":  # ns since 1970: seconds as floats would resolve 0.24 us
        return (raw - raw[0]) * 1e-9, int(raw[0]), np.ones(len(raw), dtype=bool)
    there = np.isfinite(raw)
    if not there.any():
        raise damage.refuse(f"column {columns.time!r}", "no row has a time", "give the column of the time, or a rate")
    scale = TIME[columns.time_unit]
    first = float(raw[there][0])
    if not abs(first * scale) < 9e9:
        raise damage.refuse(
            f"column {columns.time!r}", f"{first:g} {columns.time_unit} is not a valid time", "check its unit in the map"
        )
    return (raw - first) * scale, round(first * scale * 1e9), there


def _sound(
    t: np.ndarray, measured: dict[str, np.ndarray], stamped: np.ndarray, place: np.ndarray, columns: ColumnMap, damage: Damage
) -> np.ndarray:
    """(N,) bool: rows whose values an arm can have; the first bad value is reported."""
    missing = np.flatnonzero(~stamped)
    if len(missing):
        damage.report(f"row {place[missing[0]]}", f"{len(missing)} rows have no time")
    t = np.where(stamped, t, 0.0)
    used = [j for j in range(len(columns.joints)) if columns.channels["q"].columns[j]]
    part = {name: x[:, used] if name == "q" else x for name, x in measured.items()}
    fault = first_fault(t[stamped], {name: x[stamped] for name, x in part.items()})
    keep = np.ones(len(t), dtype=bool)
    if fault is not None:
        row = place[np.flatnonzero(stamped)[fault.sample]]
        joint = used[fault.joint] if fault.channel == "q" else fault.joint
        damage.report(
            f"row {row}, column {columns.channels[fault.channel].columns[joint]!r}",
            f"{fault.value:.6g} {UNIT[fault.channel]} is not a reading of an arm (rule: {fault.rule})",
        )
        bad = bad_samples(t[stamped], {name: x[stamped] for name, x in part.items()})
        keep[np.flatnonzero(stamped)[bad]] = False
        damage.note(f"{int(bad.sum())} of {len(t)} rows left out because a value in them is not a reading of an arm")
    return keep


def _unwrap(q: np.ndarray, period: float, damage: Damage) -> None:
    """Continue positions that wrap after `period` rad, in place."""
    for j in range(q.shape[1]):
        known = np.flatnonzero(np.isfinite(q[:, j]))
        turns = np.cumsum(-np.rint(np.diff(q[known, j]) / period))
        if np.any(turns != 0):
            q[known[1:], j] += period * turns
            count = int(np.count_nonzero(np.diff(turns, prepend=0.0)))
            damage.note(f"the position of joint {j + 1} wrapped {count} times after {period:.6g} rad; whole turns were added")
