"""What the pages draw beside the numbers: curves of a log that was kept apart, and the candidates that came near."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.diagnosis.answer import Diagnosis
from calib.diagnosis.selection import THRESHOLD
from calib.validation import LogCheck, checked
from logs.log import Log
from sim.arm import Arm

MOST_ROWS = 20_000
MOST_CANDIDATES = 12
MOST_OTHERS = 3


def of_check(check: LogCheck) -> dict[str, Any]:
    """Rows of one validated log, filtered as a fit's rows are: `t` (N,) s; `tau`, `tau_hat`, `q`, `dq` (N, n)."""
    m = check.measurement
    index = np.flatnonzero(m.row_usable.any(axis=1))
    index = index[:: max(1, len(index) // MOST_ROWS)]
    return {
        "log": check.log,
        "joint_names": m.joint_names,
        "t": m.trajectory.t[m.row_samples][index] - m.trajectory.t[0],
        "tau": m.rows(m.tau)[index],
        "tau_hat": m.rows(check.tau_hat)[index],
        "q": m.rows(m.trajectory.q)[index],
        "dq": m.rows(m.trajectory.dq)[index],
    }


def of_diagnosis(arm: Arm, corrected: Arm, log: Log, found: Diagnosis, others: Sequence[Log] = ()) -> dict[str, Any]:
    """What `calib.report.diagnosis.write` draws: the arm before and after on one log; the candidates.

    `others` are further held-out logs, of which only torques are drawn. A log that was found to be bad gives none of it.
    """
    if found.answer["verdict"] == "bad_data":
        return {}
    first, last = (checked(a, log, None) for a in (arm, corrected))
    curves = of_check(first)
    curves["before"], curves["after"] = curves.pop("tau_hat"), of_check(last)["tau_hat"]
    curves["others"] = []
    for other in others[:MOST_OTHERS]:
        both = [of_check(checked(a, other, None)) for a in (arm, corrected)]
        curves["others"].append(both[0] | {"before": both[0]["tau_hat"], "after": both[1]["tau_hat"]})
    return curves | {"candidates": _candidates(found), "threshold": THRESHOLD}


def _candidates(found: Diagnosis) -> list[tuple[str, str | None, float]]:
    """Effect, joint and score of the best candidates at the first step, and of every effect that was accepted later."""
    best: dict[tuple[str, str | None], float] = {}
    ladder = found.found.ladder if found.found else []
    for step in ladder[:1]:
        best |= {s.key: s.gain for s in step[:MOST_CANDIDATES]}
    for step in ladder[1:]:
        accepted = {(e.effect, e.joint) for e in found.accepted}
        best |= {s.key: max(s.gain, best.get(s.key, 0.0)) for s in step if s.key in accepted}
    return sorted(((effect, joint, gain) for (effect, joint), gain in best.items()), key=lambda c: -c[2])
