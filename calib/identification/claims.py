"""Claims of an identification, from its numbers and from the arm that it wrote."""

from __future__ import annotations

from collections.abc import Sequence

from calib.claims import Claim
from calib.measurement.preprocessing import Measurement
from calib.passivity import driving_claims
from calib.result import Estimate, FitResult, Gap
from calib.verdict import Assessment, Verdict, assess
from safety.parameters import WORDS
from sim.arm import Arm
from sim.effects.friction_law import formula
from sim.prior import unstated

LAW = "friction_law"
KEPT = 0.1  # of the file's own standard deviation: a number that moved by less counts as kept
CHANGED = 1.0  # of the estimate's standard deviation: what is written differs by more where physical consistency requires it
WORSE = 0.02  # relative rise of a joint's RMS torque error
ASIDE = ("friction_laws", "projected", "out_of_bounds", "speed_reading", "cutoff")  # stated among the findings


def shown(result: FitResult) -> tuple[Gap, str]:
    """The residual that a fit is assessed by, and the logs that it is from."""
    return (result.holdout, "the held-out logs") if result.holdout else (result.training, "the training logs")


def assessment_of(arm: Arm, result: FitResult, most: float | None = None) -> Assessment:
    """Assessment of the fitted arm on the held-out logs, or on the training logs if none is held out."""
    gap, _ = shown(result)
    return assess(result.joint_names, gap.assessed, gap.signal, arm.tau_max, most)


def claims(
    arm: Arm, result: FitResult, verdict: Assessment, written: Arm, measurements: Sequence[Measurement]
) -> tuple[Claim, ...]:
    """Claims in the order of the outcome; arm: nominal; written: identified; measurements: those it was fitted to."""
    gap, where = shown(result)
    out = [verdict.claim(result.arm, where), *driving_claims(written, measurements, gap.after)]
    beyond = [k for k, v in enumerate(verdict.verdicts) if v is Verdict.POOR]
    missing = {arm.joint_names[k]: [WORDS[key] for key, rows in unstated(arm).items() if rows[k]] for k in beyond}
    if any(missing.values()):
        out.append(Claim("unstated_drives", {"joints": {joint: words for joint, words in missing.items() if words}}))
    worse = [
        {"joint": joint, "before": float(before), "after": float(after)}
        for joint, before, after in zip(result.joint_names, gap.before, gap.after, strict=True)
        if after > (1 + WORSE) * before
    ]
    if worse:
        out.append(Claim("worse", {"where": where, "joints": worse}))
    known = [e for e in result.estimates if e.identifiable]
    out.append(Claim("identified", {"names": [e.name for e in known], "of": len(result.estimates)}))
    away = {e.name: _moved(e) for e in result.estimates if not e.identifiable}
    kept = [name for name, by in away.items() if by <= KEPT]
    moved = {name: by for name, by in away.items() if by > KEPT}
    if kept:
        out.append(Claim("kept", {"names": kept, "within": KEPT}))
    if moved:
        farthest = max(moved, key=lambda name: moved[name])
        out.append(Claim("moved", {"names": list(moved), "most": moved[farthest], "farthest": farthest}))
    laws = [{"joint": e.joint, "formula": formula(e.parameters)} for e in written.effects if e.effect == LAW]
    if laws:
        out.append(Claim("friction_laws", {"laws": laws}))
    changed = [e for e in result.estimates if not e.out_of_bounds and is_changed(e)]
    if changed:
        out.append(Claim("projected", {"parameters": [_row(e) for e in changed]}))
    outside = [e for e in result.estimates if e.out_of_bounds]
    if outside:
        out.append(Claim("out_of_bounds", {"parameters": [_row(e) | {"lower": e.lower} for e in outside]}))
    settings = result.settings
    if settings.get("speed_from") == "measured":
        out.append(Claim("speed_reading", {"speed_from": "measured"}))
    if settings.get("motion_hz") and settings["cutoff_hz"] < settings["motion_hz"]:
        out.append(Claim("cutoff", {"cutoff_hz": float(settings["cutoff_hz"]), "motion_hz": float(settings["motion_hz"])}))
    return (*out, Claim("condition", {"condition": float(result.condition), "scaled": float(result.condition_scaled)}))


def is_changed(e: Estimate) -> bool:
    """Whether the written value differs from the estimate by more than the estimate's standard deviation."""
    return e.written is not None and abs(e.written - e.value) > CHANGED * e.std


def _moved(e: Estimate) -> float:
    """Distance of the written value from the file's value, in the file's own standard deviations."""
    if e.written is None or e.nominal is None:
        return float("inf")
    if not e.prior_std:
        return 0.0 if e.written == e.nominal else float("inf")
    return float(abs(e.written - e.nominal) / e.prior_std)


def _row(e: Estimate) -> dict[str, object]:
    return {"name": e.name, "estimate": e.value, "std": e.std, "written": e.written}
