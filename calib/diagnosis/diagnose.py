"""From logs to a verdict: the missing effects by name, the corrected arm, the residual before and after on held-out logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calib.diagnosis.acceptance import Assessed
from calib.diagnosis.answer import Diagnosis, answer, entry, unusable
from calib.diagnosis.at_rest import pushed_at_rest
from calib.diagnosis.calibration import calibration
from calib.diagnosis.corrected import ArmChange, correction
from calib.diagnosis.gaps import gaps
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.model_form import form_std, with_shift
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.names import Names, names_of
from calib.diagnosis.possible import possible
from calib.diagnosis.promotion import Promotion, promoted
from calib.diagnosis.scoring import Scored
from calib.diagnosis.searched import searched
from calib.diagnosis.selection import add
from calib.diagnosis.unstated import with_unstated
from calib.diagnosis.written_arm import as_written
from calib.gate.commands import examined
from calib.measurement.limits import Limit, limits_reached
from calib.measurement.preprocessing import Measurement
from calib.passivity import driving_joints
from logs.log import Log
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named


def diagnose(
    arm: Arm, logs: Sequence[Log], holdout: Sequence[Log] = (), progress: Callable[[str], None] = lambda text: None
) -> Diagnosis:
    """Effects missing from the arm's model, assessed on `logs` and shown on `holdout` (without any, on the last log)."""
    progress("checking")
    trusted, refusal = examined(arm, (*logs, *holdout), logs)
    if refusal is not None:
        return pushed_at_rest(arm, (*logs, *holdout)) or unusable(arm, trusted)
    progress("preparing")
    every = warmed([measured(log, arm) for log in (*logs, *holdout)])
    start = with_unstated(arm, every[: len(logs)])
    every, found = searched((*logs, *holdout), every, len(logs), start, arm, progress)
    fitted, apart = every[: len(logs)], every[len(logs) :]
    # A limit that was reached needs no fit: the arm did what the torque allowed, so clipping its model explains nothing.
    reached = limits_reached(arm, (*logs, *holdout))
    limits = tuple(x.effect for x in reached)
    names = names_of(fitted, found, apart, limits, progress)
    found = names.found
    progress("testing the corrected arm")
    promotion = promoted(fitted, names.written, found.baseline, apart, limits)
    # an effect that the following error shows exists, even if it does not improve the torque prediction
    shown_otherwise = found.best.hypothesis.observed
    names = names.without([r.effect for r in promotion.refused if not r.by_law and r.effect.key not in shown_otherwise])
    refit = correction(as_written(fitted, found.baseline))
    change = promotion.change or (refit if start is not arm else None)
    shown = apart or every[-1:]
    result = answer(
        arm, names.verdict(bool(reached)), _entries(arm, names, promotion, reached), [u.entry() for u in names.odd],
        _gaps(arm, {"refit": refit, "after": change}, start, shown), shown[0].name, trusted,
    )  # fmt: skip
    refused = [*dict.fromkeys(names.vetoed), *[r.text for r in promotion.refused]]
    if change is None and refused:
        result["arm_out"] = None
    result["gap"]["held_out"] = bool(apart)
    noise = found.best.solved.noise
    result["gap"]["noise_floor"] = [] if noise.bound else [float(x) for x in noise.sigma]
    result |= {
        "noise_source": None if noise.bound else "what an additive basis and all candidate effects leave in the recordings",
        "false_names": _false_names(names),
        "possible": _possible(fitted, names, [*names.effects, *limits, *(r.effect for r in promotion.refused)]),
        "refused": refused,
        "motion": [{"before": a.entry(), "after": b.entry()} for a, b in promotion.motion],
        "laws": [x.entry() for x in promotion.laws],
        "driving": driving_joints(start if change is None else change.of(start), shown, np.array(result["gap"]["after"])),
        "calibration": [x.entry() for x in calibration(found.baseline)],
    }
    return Diagnosis(result, names.effects, found, change, limits, found.ladder)


def _entries(arm: Arm, names: Names, promotion: Promotion, reached: Sequence[Limit]) -> list[dict[str, Any]]:
    """The effects of diagnosis.json: the fitted ones by their share of the torque gap, then the limits.

    A joint effect comes from the fit in which the lead of every joint's friction is free. Otherwise that lead goes into the
    friction parameters (presliding stiffness 20 % high on the exam, 2 % with it). An effect of the whole arm is given as the
    arm folder holds it, fitted with fewer free parameters. That is slightly the better of the two: of 20 payloads, tilts and
    forces of used exams, 32 parameters are nearer to the truth and 21 are not.
    """
    observed = names.fit.hypothesis.observed

    def of_torque(a: Assessed) -> float:
        """What an effect explains, less what another channel shows of it."""
        one = observed.get(a.effect.key)
        return max(a.lost - (one.loss(0.0) if one else 0.0), 0.0)

    total = max(sum(of_torque(a) for a in names.assessed), 1e-9)

    laws = {e.key: std for e, std in zip(names.fit.accepted, form_std(names.fit), strict=True)}
    entries = []
    for a in names.kept:
        std, by_law, item, written = names.std_of(a.effect), laws[a.effect.key], a.effect, promotion.written(a.effect)
        if written is not None and effect_named(item.effect).scope == "arm":
            item, std, by_law = written, std | dict(written.std), with_shift(by_law, item, written)
        made = entry(arm, item, std, a.confidence, of_torque(a) / total, a.rivals, by_law, written)
        if a.effect.key in observed:
            made["measured_by"] = "following error"
        event = names.fit.hypothesis.event_log
        if a.effect.effect == CONTACT and event is not None:
            made["log"] = names.fit.models[event].measurement.name
        entries.append(made | {"false_name_rate": names.null.rate(a.effect.key, a.lost)})
    entries.sort(key=lambda x: -x["gap_share"])
    # a limit is not fitted to torque: the arm did what it allowed
    limits = [entry(arm, x.effect, {"limit": x.std}, x.confidence, 0.0) for x in reached]
    return entries + [x | {"measured_by": "lag behind the command"} for x in limits]


def _false_names(names: Names) -> dict[str, Any]:
    """chance: how often, without any effect, some candidate brings as much as the strongest one left without a name."""
    left = [s for s in (names.found.ladder[-1] if names.found.ladder else []) if s.effect.effect != CONTACT]
    chance = min((names.null.rate(s.key, s.gain) for s in left), default=1.0)
    return {"simulated": len(names.null.largest), "chance": chance}


def _possible(fitted: Sequence[Measurement], names: Names, have: Sequence[ArmEffect]) -> list[dict[str, Any]]:
    best, ladder = names.found.best, names.found.ladder
    ranked = ladder[-1] if ladder and not names.odd else []

    def brought(s: Scored) -> float:
        return best.objective - add(fitted, best, s).objective

    return possible(ranked, names.null, {e.key for e in have}, brought)


def _gaps(given: Arm, changes: dict[str, ArmChange | None], start: Arm, shown: list[Measurement]) -> dict[str, Any]:
    """RMS per joint on `shown`: of the given arm, after an ordinary refit, and of the corrected arm."""
    arms = {"before": given} | {key: start if change is None else change.of(start) for key, change in changes.items()}
    return gaps(arms, shown)
