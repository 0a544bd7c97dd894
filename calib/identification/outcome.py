"""An identification as readers see it: tables of numbers, and the curves that a page draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.identification.claims import is_changed
from calib.identification.identify import Identification
from calib.identification.model import FRICTION
from calib.identification.rows import RegressorRows
from calib.result import Estimate, FitResult, Gap
from calib.terminal.quantity import rounded, significant
from logs.normal import INTERVAL
from sim.prediction import torque_of_laws

MOST_ROWS = 20_000


def gap_table(joint_names: tuple[str, ...], gap: Gap) -> tuple[list[str], list[list[Any]]]:
    """Residual RMS before and after, N m and, with torque constants, A; sliding: without the rows near reversals.

    Where a motion repeats itself, `periods` is the torque's standard deviation between its periods, which no model explains.
    """
    headers = ["joint", "before [N m]", "after [N m]", "sliding [N m]", "torque std [N m]", "residual share"]
    headers += [] if gap.noise is None else ["periods [N m]"]
    rows: list[list[Any]] = []
    for j, joint in enumerate(joint_names):
        left = gap.assessed[j] / gap.signal[j] if gap.signal[j] > 0 else np.nan
        row = [
            joint,
            float(gap.before[j]),
            float(gap.after[j]),
            *[float(x[j]) for x in (gap.assessed, gap.signal)],
            None if np.isnan(left) else f"{left:.1%}",
        ]
        if gap.noise is not None:
            row.append(float(gap.noise[j]))
        if gap.before_ampere is not None and gap.after_ampere is not None:
            row += [float(gap.before_ampere[j]), float(gap.after_ampere[j])]
        rows.append(row)
    return (headers if gap.after_ampere is None else [*headers, "before [A]", "after [A]"]), rows


def parameter_table(result: FitResult) -> tuple[list[str], list[list[Any]]]:
    """Friction and reflected inertia of every joint, each as value ± standard deviation."""
    shown = [
        ("Ia", "reflected inertia [kg m^2]"),
        *[(k, f"{k} [{u}]") for k, u in zip(FRICTION, ("N m s/rad", "N m", "N m"), strict=True)],
    ]
    rows: list[list[Any]] = []
    for j, joint in enumerate(result.joint_names):
        cells = []
        for kind, _ in shown:
            e = result.estimate(f"{kind}_{j + 1}")
            cells.append(as_text(e))
        rows.append([joint, *cells])
    return ["joint", *[title for _, title in shown]], rows


def as_text(e: Estimate) -> str:
    """An estimate as value ± standard deviation, or its upper limit if out of bounds; and the written value if that differs."""
    changed = ""
    if e.written is not None and (is_changed(e) or e.out_of_bounds):
        changed = f", written {rounded(e.written, e.std).split(' ')[0]}"
    if e.out_of_bounds:
        most = e.value + INTERVAL * e.std
        return (f"below {significant(most)}" if most > e.lower else "physically impossible") + changed
    return rounded(e.value, e.std) + ("" if e.identifiable else " (not identifiable)") + changed


def evidence(found: Identification) -> dict[str, Any]:
    """Filtered rows of the first held-out log, else of the first training log: torque predicted before and after, and measured.

    None of them includes the torque of effects that the arm had before and keeps.
    """
    m = (found.holdout or found.measurements)[0]
    rows = RegressorRows(found.model, [m])
    n = found.model.arm.n
    nominal, fitted = found.model.nominal(), found.possible.theta
    before: list[np.ndarray] = []
    after: list[np.ndarray] = []
    for block in rows:
        for theta, out in ((nominal, before), (fitted, after)):
            out.append(np.stack([block.a[j] @ theta[rows.used[j]] for j in range(n)], axis=1))
    by_laws = m.rows(torque_of_laws(found.laws, found.model.arm, m.trajectory))
    index = np.flatnonzero(m.row_usable.any(axis=1))
    index = index[:: max(1, -(-len(index) // MOST_ROWS))]
    return {
        "joint_names": m.joint_names,
        "log": m.name,
        "t": m.trajectory.t[m.row_samples][index] - m.trajectory.t[0],
        "tau": m.rows(m.tau)[index],
        "before": np.concatenate(before)[index],
        "after": (np.concatenate(after) + by_laws)[index],
        "q": m.rows(m.trajectory.q)[index],
        "dq": m.rows(m.trajectory.dq)[index],
    }
