"""CSV files of ur_rtde's recorder: `timestamp,actual_q_0,...`, one row per sample, controller clock.

`target_current` and `target_moment` are outputs of the controller's own model; they are never read as measurements. The
controller reports currents and no joint torque, so `tau` is NaN.
"""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path

import numpy as np

from logs.damage import Damage
from logs.log import Log, State
from logs.plausible import UNIT, bad_samples, first_fault
from logs.timing import checked_times
from sim.errors import BadLog
from sim.files import read_bytes

UR_JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip
COLUMNS = {
    "q": "actual_q", "dq": "actual_qd", "current": "actual_current", "temperature": "joint_temperatures",
    "q_cmd": "target_q", "dq_cmd": "target_qd",
}  # fmt: skip
REQUIRED = ("q", "dq", "current")
MAX_BYTES = 2 << 30
MAX_HEADER = 1 << 16


def looks_like_csv(head: bytes) -> bool:
    """Whether the first bytes of a file can be the header of such a CSV file; its columns may be in any order.

    Many tables have a column `timestamp`; the name of the positions is specific to ur_rtde.
    """
    first = head.removeprefix(b"\xef\xbb\xbf").partition(b"\n")[0]
    return re.search(rb"(^|,)\s*\"?actual_q_\d\"?\s*(,|\r?$)", first) is not None


def read_csv(path: Path, accept_partial: bool = False) -> Log:
    """Return the samples of `path`, one per row; BadLog names row, column, value and rule of the first bad value."""
    damage = Damage(path, accept_partial)
    text = read_bytes(path, MAX_BYTES, BadLog, "split the recording into shorter ones").removeprefix(b"\xef\xbb\xbf")
    head, _, body = text[:MAX_HEADER].partition(b"\n")
    if len(head) == MAX_HEADER:
        raise damage.refuse("row 1", f"no end of line in {MAX_HEADER} bytes", "give a CSV file with a header row")
    body = text[len(head) + 1 :]
    stamp, columns = _columns(head.decode("utf-8", errors="replace"), damage)
    names = ["timestamp", *(f"{COLUMNS[key]}_{j}" for key in columns for j in range(len(UR_JOINTS)))]
    places = [columns_at for key in columns for columns_at in columns[key]]
    table, rows = _table(body, head.count(b",") + 1, [stamp, *places], names, damage)
    t = table[:, 0]
    n = len(UR_JOINTS)
    parts: dict[str, np.ndarray] = {key: table[:, 1 + k * n : 1 + (k + 1) * n] for k, key in enumerate(columns)}
    measured: dict[str, np.ndarray] = {key: parts[key] for key in ("q", "dq", "current", "temperature") if key in parts}
    _refuse_implausible(t, measured, rows, damage)
    keep = ~bad_samples(t, measured)
    if not keep.any():
        raise damage.refuse("rows", "no sound sample", "record it again")
    t, parts = t[keep], {key: value[keep] for key, value in parts.items()}
    origin = round(float(t[0]) * 1e9)
    nothing = np.broadcast_to(np.float64(np.nan), (len(t), n))
    seconds = (np.rint(t * 1e9).astype(np.int64) - origin) * 1e-9
    seconds, _ = checked_times(seconds, nothing[:, 0], damage, (parts["q"], parts["dq"]))
    return Log(
        UR_JOINTS, seconds, nothing[:, 0], parts["q"], parts["dq"], nothing, parts["current"], parts.get("temperature", nothing),
        parts.get("q_cmd", nothing), parts.get("dq_cmd", nothing), nothing, {"format": "ur_rtde CSV"}, (),
        damage.all_findings(), path, State.CUT if damage.count else State.UNSTATED, None, origin,
    )  # fmt: skip


def _columns(header: str, damage: Damage) -> tuple[int, dict[str, list[int]]]:
    """Column of the clock, and channel -> its six columns; the required ones must be present, each once."""
    names = [name.strip().strip('"') for name in header.rstrip("\r\n").split(",")]
    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise damage.refuse("row 1", f"column {min(repeated)!r} occurs twice", "keep one of them")
    if "timestamp" not in names:
        raise damage.refuse(
            "row 1", "column timestamp is missing", "record with ur_rtde's variable timestamp: s, controller clock"
        )
    out = {}
    for key, stem in COLUMNS.items():
        wanted = [f"{stem}_{j}" for j in range(len(UR_JOINTS))]
        missing = [name for name in wanted if name not in names]
        if not missing:
            out[key] = [names.index(name) for name in wanted]
        elif key in REQUIRED or len(missing) < len(wanted):
            raise damage.refuse(
                "row 1", f"columns {', '.join(missing)} are missing; {stem}_0 to {stem}_5 belong together",
                "record with ur_rtde's variables timestamp, actual_q, actual_qd, actual_current",
            )  # fmt: skip
    return names.index("timestamp"), out


def _table(body: bytes, width: int, places: list[int], names: list[str], damage: Damage) -> tuple[np.ndarray, np.ndarray]:
    """The wanted columns as numbers (N, len(places)), and the file row of each sample (1-based; the header is row 1)."""
    if not body.strip():
        raise damage.refuse("row 2", "the file has a header and no samples", "record it again")
    complete = body.endswith(b"\n")
    if complete and b"\n\n" not in body and b"\n\r\n" not in body and b'"' not in body:
        lines = body.count(b"\n")
        if body.count(b",") == lines * (width - 1):
            try:
                table = np.loadtxt(io.BytesIO(body), delimiter=",", comments=None, usecols=places, ndmin=2)
            except ValueError:
                table = np.empty((0, 0))
            # loadtxt accepts rows of unequal width where the wanted columns are present; the total of commas does not exclude that
            if len(table) == lines and np.isfinite(table).all() and _equal_width(body, width):
                return table, np.arange(2, lines + 2)
    return _table_by_row(body, width, places, names, complete, damage)


def _equal_width(body: bytes, width: int) -> bool:
    raw = np.frombuffer(body, dtype=np.uint8)
    marks = raw[(raw == ord(",")) | (raw == ord("\n"))].reshape(-1, width)
    return bool((marks[:, -1] == ord("\n")).all())


def _table_by_row(
    body: bytes, width: int, places: list[int], names: list[str], complete: bool, damage: Damage
) -> tuple[np.ndarray, np.ndarray]:
    samples, rows = [], []
    lines = body.decode("utf-8", errors="replace").splitlines()
    for row, line in enumerate(lines, start=2):
        cells = next(csv.reader([line]), [])
        if not cells:
            damage.report(f"row {row}", "the row is empty")
        elif len(cells) != width:
            damage.report(f"row {row}", f"{len(cells)} values where the header has {width} columns")
        elif row == len(lines) + 1 and not complete:
            damage.report(f"row {row}", f"the file ends inside this row, after {cells[-1]!r}: the number may be cut short")
        else:
            sample = [_number(cells[place]) for place in places]
            wrong = [k for k, value in enumerate(sample) if not math.isfinite(value)]
            if wrong:
                k = wrong[0]
                damage.report(f"row {row}, column {names[k]}", f"{cells[places[k]]!r:.60} is not a finite number")
            else:
                samples.append(sample)
                rows.append(row)
    if not samples:
        raise damage.refuse("rows", "no sound sample", "record it again")
    return np.array(samples), np.array(rows)


def _number(cell: str) -> float:
    try:
        return float(cell) if "_" not in cell else math.nan
    except ValueError:
        return math.nan


def _refuse_implausible(t: np.ndarray, measured: dict[str, np.ndarray], rows: np.ndarray, damage: Damage) -> None:
    fault = first_fault(t, measured)
    if fault is None:
        return
    where = f"row {rows[fault.sample]}, column {COLUMNS[fault.channel]}_{fault.joint}"
    damage.report(where, f"{fault.value:.6g} {UNIT[fault.channel]} is not a reading of an arm (rule: {fault.rule})")
    bad = int(bad_samples(t, measured).sum())
    damage.note(f"{bad} of {len(t)} rows left out because a value in them is not a reading of an arm")
