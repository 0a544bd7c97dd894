"""`calib diagnose --baseline`: what has changed since the healthy recordings, as diagnosis.json and a corrected arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calib.diagnosis.answer import Diagnosis, answer, entry, unusable
from calib.diagnosis.at_rest import pushed_at_rest
from calib.diagnosis.baseline import Healthy, Since
from calib.diagnosis.corrected import ArmChange, finite
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.model import LogModel
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.prices import confidence
from calib.diagnosis.scored_changes import Changed
from calib.diagnosis.unstated import with_unstated
from calib.diagnosis.written_arm import rms_where, torque_errors
from calib.gate.commands import examined
from calib.measurement.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm
from sim.errors import BadLog, ConfigError

LEAST_LOGS = 3
SURER = 4.0  # rise of a change's likelihood ratio that multiplies its odds by e
# Relative rise of a joint's residual RMS. Under a change of the whole arm, joints that hardly carry it vary by the noise of a
# recording. Not tuned.
WORSE = 0.05


def diagnose_changes(
    arm: Arm,
    logs: Sequence[Log],
    holdout: Sequence[Log],
    baseline: Sequence[Log],
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """The effects in `logs` that are not in `baseline`, at least three recordings of the healthy arm.

    A corrected arm is offered if it predicts no changed joint worse. ConfigError for fewer baseline recordings: two days of an
    arm do not show how it varies from day to day. BadLog if a joint moves only in the new recordings.
    """
    require_baseline(len(baseline))
    progress("checking")
    trusted, refusal = examined(arm, (*baseline, *logs, *holdout), logs)
    if refusal is not None:
        return pushed_at_rest(arm, (*logs, *holdout)) or unusable(arm, trusted)
    progress("preparing")
    every = warmed([measured(log, arm) for log in (*baseline, *logs, *holdout)])
    healthy, after, apart = (
        every[: len(baseline)],
        every[len(baseline) : len(baseline) + len(logs)],
        every[len(baseline) + len(logs) :],
    )
    _require_moved(arm, healthy, (*after, *apart))
    shown = apart or after[-1:]
    progress("fitting the healthy arm")
    reference = Healthy(with_unstated(arm, healthy), healthy)
    progress("comparing with the healthy arm")
    found = reference.since(after, apart)
    total = sum(c.gain for c in found.changes)
    entries = [
        entry(
            arm,
            c.effect,
            c.std,
            confidence(c.gain, SURER, len(c.rivals)),
            c.gain / total,
            c.rivals,
        )
        | ({} if c.log is None else {"log": after[c.log].name})
        for c in found.changes
    ]
    odd = [{"joint": arm.joint_names[j], "depends_on": [name], "rms": rms, "unit": "N*m"} for j, name, rms, _ in found.odd]
    verdict = "unexplained" if odd else "effects_found" if entries else "no_missing_effect"
    result = answer(arm, verdict, entries, odd, _gap(reference, found, shown), shown[0].name, trusted)
    result["gap"]["held_out"] = bool(apart)
    result |= {"question": "what has changed since the healthy recordings", "baseline": [m.name for m in healthy]}
    lasting = [c for c in found.changes if c.effect.effect != CONTACT]
    correction = ArmChange({}, tuple(replace(c.effect, std=finite(c.effect, c.std)) for c in lasting)) if lasting else None
    if correction is not None:
        used = np.concatenate([m.row_usable[m.row_moving] for m in shown])
        before, with_it = (
            np.where(used.any(axis=0), rms_where(torque_errors(a, shown), used), 0.0) for a in (arm, correction.of(arm))
        )
        result["gap"] |= {"given_arm": before.tolist(), "corrected_arm": with_it.tolist()}
        if refused := _worse(arm, lasting, before, with_it, result["gap"]["log"]):
            result |= {"refused": refused, "arm_out": None}
            correction = None
    return Diagnosis(result, tuple(c.effect for c in found.changes), None, correction)


def _worse(arm: Arm, changes: Sequence[Changed], before: np.ndarray, with_it: np.ndarray, log: str) -> list[str]:
    """Why the corrected arm is refused: it predicts a changed joint worse, as when the given arm already holds the change."""
    joints = {c.effect.joint for c in changes}
    worse = [
        f"{name} ({before[j]:.3g} -> {with_it[j]:.3g} N m)"
        for j, name in enumerate(arm.joint_names)
        if joints & {name, None} and with_it[j] > (1 + WORSE) * before[j]
    ]
    if not worse:
        return []
    return [
        f"the corrected arm has a higher residual RMS on {log} than the given one at {', '.join(worse)}: the given arm may hold this change "
        "already, or does not agree with its healthy recordings"
    ]


def require_baseline(count: int) -> None:
    """ConfigError unless there are enough recordings of the healthy arm to show how it varies."""
    if count < LEAST_LOGS:
        raise ConfigError(
            f"--baseline: {count} recordings; at least {LEAST_LOGS} of the healthy arm are needed to show how it varies "
            "from one recording to the next; record the plan again, or give more recordings"
        )


def _require_moved(arm: Arm, healthy: Sequence[Measurement], new: Sequence[Measurement]) -> None:
    """BadLog if a joint moves only in the new recordings, because its healthy behaviour is then unknown."""
    before, now = ([any(m.row_usable[:, j].any() for m in x) for j in range(arm.n)] for x in (healthy, new))
    unknown = [joint for joint, a, b in zip(arm.joint_names, before, now, strict=True) if b and not a]
    if unknown:
        raise BadLog(
            f"--baseline: {', '.join(unknown)} moves in the new recordings but stands still in all of the healthy arm; record the healthy arm "
            "in the same motion, or give new recordings in which the same joints move"
        )


def _gap(reference: Healthy, found: Since, shown: list) -> dict[str, list[float]]:  # type: ignore[type-arg]
    """RMS per joint beside the healthy law, before and with the changes; the noise is what the law leaves of healthy logs."""
    models = [LogModel(m, reference.hypothesis) for m in shown]
    rows = reference.law.rows(models)
    before = [float(np.sqrt(np.mean(r**2))) if len(r) else 0.0 for r in rows.r]
    after = [float(np.sqrt(np.mean(r**2))) if len(r) else 0.0 for r in found.left(reference, models)]
    return {"noise_floor": [float(s) for s in found.noise.sigma], "before": before, "refit": [], "after": after}
