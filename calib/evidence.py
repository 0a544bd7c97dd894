"""Data that the pages draw: curves of a held-out log, the best candidates, and the torque with and without each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.diagnosis.answer import Diagnosis
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.prices import THRESHOLD
from calib.validation.validate import LogCheck, checked
from logs.log import Log
from sim.arm import Arm
from sim.effects import with_effect
from sim.prediction import predict

MOST_ROWS = 20_000
MOST_CANDIDATES = 12
MOST_OTHERS = 3
MOST_SWITCHED = 8  # effects that can be switched on and off on the page


def of_check(check: LogCheck) -> dict[str, Any]:
    """Rows of one validated log, filtered like the rows of a fit: `t` (N,) s; `tau`, `tau_hat`, `q`, `dq` (N, n)."""
    m, index = check.measurement, _shown(check)
    return {
        "log": check.log,
        "joint_names": m.joint_names,
        "t": m.trajectory.t[m.row_samples][index] - m.trajectory.t[0],
        "tau": m.rows(m.tau)[index],
        "tau_hat": m.rows(check.tau_hat)[index],
        "q": m.rows(m.trajectory.q)[index],
        "dq": m.rows(m.trajectory.dq)[index],
    }


def _shown(check: LogCheck) -> np.ndarray:
    index = np.flatnonzero(check.measurement.row_usable.any(axis=1))
    return index[:: max(1, -(-len(index) // MOST_ROWS))]


def of_diagnosis(arm: Arm, corrected: Arm, log: Log, found: Diagnosis, others: Sequence[Log] = ()) -> dict[str, Any]:
    """Data for `calib.report.diagnosis.write`: the arm before and after on one log, and the candidates.

    others: further held-out logs, drawn as torques only. `switched` of each log lists the effects that can be switched on the page:
    `effect`, `joint`, `identified` and `tau` (N, n), which is of the corrected arm without an identified effect, or of the nominal arm
    with any other effect. Empty for bad data.
    """
    if found.answer["verdict"] == "bad_data":
        return {}
    first, last = (checked(a, log, None) for a in (arm, corrected))
    curves = of_check(first)
    curves["before"], curves["after"] = curves.pop("tau_hat"), of_check(last)["tau_hat"]
    arms = _switched(arm, found)
    curves["switched"] = _with_and_without(first, arms)
    curves["others"] = []
    for other in others[:MOST_OTHERS]:
        checks = [checked(a, other, None) for a in (arm, corrected)]
        both = [of_check(check) for check in checks]
        both[0] |= {"before": both[0]["tau_hat"], "after": both[1]["tau_hat"]}
        curves["others"].append(both[0] | {"switched": _with_and_without(checks[0], arms)})
    return curves | {"candidates": _candidates(found), "threshold": THRESHOLD}


def _switched(arm: Arm, found: Diagnosis) -> list[tuple[str, str | None, bool, Arm]]:
    """(effect, joint, whether it was identified, the arm that shows it: corrected without it, or nominal with it).

    Contacts are left out: a contact is an event of one log, not a property of the arm. The effects that were not identified are the
    most promising of the first step of the search.
    """
    change, keys = found.correction, {e.key for e in found.accepted if e.effect != CONTACT}
    out = []
    for item in change.effects if change is not None else ():
        if change is not None and (key := item.key) in keys:
            rest = tuple(e for e in change.effects if e.key != key)
            out.append((*key, True, replace(change, effects=rest).of(arm)))
    for step in found.steps[0] if found.steps else ():
        if step.key not in keys and step.key[0] != CONTACT and len(out) < MOST_SWITCHED:
            out.append((*step.key, False, with_effect(arm, step.effect)))
    return out


def _with_and_without(check: LogCheck, arms: Sequence[tuple[str, str | None, bool, Arm]]) -> list[dict[str, Any]]:
    """`tau` (N, n) N m along the rows that `of_check` shows, for each of the arms."""
    m, index = check.measurement, _shown(check)
    return [
        {"effect": effect, "joint": joint, "identified": identified, "tau": m.rows(predict(shown, m.trajectory))[index]}
        for effect, joint, identified, shown in arms
    ]


def _candidates(found: Diagnosis) -> list[tuple[str, str | None, float]]:
    """Effect, joint and score of the best candidates at the first step, and of every effect that was accepted later."""
    best: dict[tuple[str, str | None], float] = {}
    for step in found.steps[:1]:
        best |= {s.key: s.gain for s in step[:MOST_CANDIDATES]}
    for step in found.steps[1:]:
        accepted = {e.key for e in found.accepted}
        best |= {s.key: max(s.gain, best.get(s.key, 0.0)) for s in step if s.key in accepted}
    return sorted(((effect, joint, gain) for (effect, joint), gain in best.items()), key=lambda c: -c[2])
