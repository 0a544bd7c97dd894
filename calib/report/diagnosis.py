"""The page of `calib diagnose`: what is missing, where it shows, why that effect, what it explains, what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims.claim import capital
from calib.claims.diagnosis_sentences import chance
from calib.claims.of_diagnosis import REMARKS, agreement, claims, disagrees, is_corrected, lasting, over_noise, verdict
from calib.report import explorer, pictures
from calib.report.evidence import add_evidence, add_gap
from calib.report.page import Page, Verdict
from calib.terminal.quantity import printed_unit as unit_of
from sim.arm import Arm

REFIT_HELPS = 0.2  # share by which a refit must lower a joint's residual RMS to be proposed
MEASURE_NOISE = "Record longer motions, such as those of `calib plan` without --quick, and diagnose with them, so that the noise can be measured."
HERE = Path()
_VERDICTS: dict[str, Verdict] = {
    "effects_found": "found",
    "no_missing_effect": "good",
    "unexplained": "open",
    "bad_data": "bad",
}


def write(path: str | Path, diagnosis: Mapping[str, Any], evidence: Mapping[str, Any], arm: Arm | None = None) -> Path:
    """Write the page of a diagnosis; returns its path.

    diagnosis  the content of diagnosis.json
    evidence   `joint_names`; `t` (N,) s; `tau`, `before`, `after`, `q`, `dq` (N, n) on the held-out log; `candidates`:
               (effect, joint, score) of the runners-up, and the `threshold` that a name must reach; `others`: the same arrays on
               further held-out logs. Without arrays (bad data) the page has no pictures.
    arm        for the interactive curves and the arm in 3D, which are left out without it
    """
    page = Page(str(diagnosis["arm"]), sentence(diagnosis), style(diagnosis), _facts(diagnosis), "diagnosis")
    page.aside("What to do next", actions(diagnosis, Path(path).parent))
    if known := remarks(diagnosis):
        page.section("What to know about it").items(known)
    if evidence.get("t") is not None:
        if arm is not None:
            page.section("Look at the residual")
            names = list(evidence["joint_names"])
            joint = names[_joints_in_question(diagnosis, names)[0]]
            explorer.add(page, arm, [evidence, *evidence.get("others", ())], ("before", "after"), joint=joint)
        _where(page, diagnosis, evidence)
    add_evidence(page, diagnosis, evidence)
    add_gap(page, diagnosis)
    if evidence.get("t") is not None:
        _every_joint(page, diagnosis, evidence)
    checks = diagnosis.get("data_checks", [])
    if checks:
        passed = all(c["ok"] for c in checks)
        caption = f"All checks of the recordings passed ({len(checks)})" if passed else ""
        page.section("Can the data be trusted?").table(
            ["check", "ok", "detail"], [[c["check"], bool(c["ok"]), c["detail"]] for c in checks], caption, fold=passed
        )
    return page.write(path)


def style(diagnosis: Mapping[str, Any]) -> Verdict:
    """The mark before the verdict."""
    return "open" if disagrees(diagnosis) else _VERDICTS[diagnosis["verdict"]]


def sentence(diagnosis: Mapping[str, Any]) -> str:
    """The verdict in words."""
    return verdict(diagnosis).sentence


def remarks(diagnosis: Mapping[str, Any]) -> list[str]:
    """Sentences on the gain of the corrected arm, friction laws, refused effects, and parameters that a refit moves far."""
    return [f"{capital(claim.sentence)}." for claim in claims(diagnosis) if claim.name in REMARKS]


def next_steps(diagnosis: Mapping[str, Any], folder: Path = HERE) -> list[str]:
    """The remarks, then the actions; folder: that of the run."""
    return [*remarks(diagnosis), *actions(diagnosis, folder)]


def actions(diagnosis: Mapping[str, Any], folder: Path = HERE) -> list[str]:
    """What the person at the robot should do next; folder: that of the run."""
    steps = [f"{claim.sentence}." for claim in claims(diagnosis) if claim.name == "alike"]
    steps += [f"To confirm it: {e['experiment']}" for e in diagnosis.get("effects", []) if e.get("experiment")]
    verdict = diagnosis["verdict"]
    if verdict == "effects_found" and not lasting(diagnosis):
        steps.append("Find what the arm touches, and repeat the recording without it; the arm's model stays unchanged.")
    elif verdict == "effects_found" and is_corrected(diagnosis):
        steps.append(
            f"Use the corrected arm folder {folder / diagnosis['arm_out']} wherever the nominal one was used; test it with calib validate on a log that it has not seen."
        )
    elif disagrees(diagnosis):
        joint = agreement(diagnosis.get("gap") or {})["joint"]
        steps.append(f"Look at {f'{joint}’s' if joint else 'the'} curves in the report, and record the motion again.")
    elif verdict == "no_missing_effect" and not diagnosis.get("refused"):
        steps.append(
            refit(diagnosis)
            or (MEASURE_NOISE if noise_unknown(diagnosis) else "Nothing to do: the model agrees with these recordings.")
        )
    elif verdict == "unexplained":
        steps.append(
            "Inspect the joint and what moves with it; the curves in the report show when the residual appears. Record it again, warm and slow, to see whether the residual is still there."
        )
    elif verdict == "bad_data":
        steps.append(
            "Correct what the refusal names, in the arm's folder, the cell or the recording, and diagnose again; record again only if a reading is lost."
        )
    if diagnosis["arm_out"] is None and diagnosis.get("refused"):
        steps.append("The arm stays unchanged: none of the corrected arms that were tried is better.")
        steps += filter(None, [refit(diagnosis)])
    return steps


def noise_unknown(diagnosis: Mapping[str, Any]) -> bool:
    """Whether the residual was not compared with the noise, so that the agreement is unknown."""
    first = claims(diagnosis)[0]
    return first.name == "complete" and first.numbers["ratio"] is None


def refit(diagnosis: Mapping[str, Any]) -> str:
    """What to do if only ordinary parameters are off; empty if a refit lowers no joint's residual by REFIT_HELPS."""
    gap = diagnosis.get("gap") or {}
    rows = list(zip(gap.get("joints", ()), gap.get("before", ()), gap.get("refit", ()), strict=False))
    joint, before, refit = min(rows, key=lambda row: row[2] / max(row[1], 1e-12), default=("", 1.0, 1.0))
    if refit > (1.0 - REFIT_HELPS) * before:
        return ""
    return (
        f"Refit the ordinary parameters with calib identify and these recordings: at {joint} the residual RMS falls "
        f"from {before:.3g} to {refit:.3g} N m."
    )


def _facts(diagnosis: Mapping[str, Any]) -> list[tuple[str, Any]]:
    facts: list[tuple[str, Any]] = []
    effects = diagnosis.get("effects", [])
    if effects:
        least = min(float(e["confidence"]) for e in effects)
        facts.append(("confidence in the effect" if len(effects) == 1 else "confidence, least certain effect", f"{least:.0%}"))
        rates = [e["false_name_rate"] for e in effects if "false_name_rate" in e]
        if rates:
            facts.append(("chance that noise alone looks like this", f"at most {chance(max(rates))}"))
    gap = diagnosis.get("gap") or {}
    if gap.get("noise_floor"):
        worst = [float(np.nanmax(x)) for x in over_noise(gap).values() if np.isfinite(x).any()]
        if len(worst) > 1:
            roles = " → ".join(pictures.WORDS[role] for role in over_noise(gap))
            facts.append((f"worst joint, {roles}", " → ".join(f"{w:.1f}×" for w in worst) + " noise"))
        facts.append((_which(gap), gap.get("log", "")))
    return facts


def _which(gap: Mapping[str, Any]) -> str:
    """The kind of log on which the gap was measured; a fitted one flatters the corrected arm."""
    return "held-out log" if gap.get("held_out") else "fitted log (no log was held out)"


def _where(page: Page, diagnosis: Mapping[str, Any], evidence: Mapping[str, Any]) -> None:
    names = list(evidence["joint_names"])
    unit = unit_of(diagnosis.get("gap", {}).get("unit", "N*m"))
    tau = np.asarray(evidence["tau"])
    predicted = {role: np.asarray(evidence[role]) for role in ("before", "after")}
    page.section("Where the residual is")
    gap = diagnosis.get("gap") or {}
    levels = over_noise(gap)
    if all(np.isfinite(x).any() for x in levels.values()) and len(levels) > 1:
        what = (
            "Residual RMS while a joint slides"
            if "baseline" not in diagnosis
            else "RMS of the residual that the healthy recordings do not explain"
        )
        page.figure(
            pictures.gaps(gap["joints"], levels),
            f"{what}, over the noise floor of each joint: {_which(gap)} {gap['log']}. {gained(diagnosis)}",
        )
    for j in _joints_in_question(diagnosis, names):
        residuals = {role: tau[:, j] - value[:, j] for role, value in predicted.items()}
        q, dq = (np.asarray(evidence[key])[:, j] for key in ("q", "dq"))
        page.figure(
            pictures.where(names[j], np.asarray(evidence["t"]), q, dq, predicted["before"][:, j], residuals, unit),
            f"Residual at {names[j]}, before and after: over time, speed, position and load. A slope, a step or a wave is "
            "structure; a flat band is noise.",
        )


def gained(diagnosis: Mapping[str, Any]) -> str:
    """What the effects explain beyond a parameter refit, or beyond the healthy arm, at the joint with the largest residual before them."""
    gap = diagnosis["gap"]
    levels = over_noise(gap)
    role = "refit" if "refit" in levels else "before"
    j = int(np.nanargmax(levels[role]))
    text = f"{capital(pictures.WORDS[role])} it is {levels[role][j]:.1f} times the noise at {gap['joints'][j]}"
    return text + (f"; with the identified effects {levels['after'][j]:.1f}." if diagnosis.get("effects") else ".")


def _every_joint(page: Page, diagnosis: Mapping[str, Any], evidence: Mapping[str, Any]) -> None:
    predicted = {role: np.asarray(evidence[role]) for role in ("before", "after")}
    unit = unit_of(diagnosis["gap"]["unit"])
    page.section("Every joint").figure(
        pictures.torques(
            list(evidence["joint_names"]), np.asarray(evidence["t"]), np.asarray(evidence["tau"]), predicted, unit
        ),
        "Measured torque with the model's prediction before and after (left), and the residuals (right).",
    )


def _joints_in_question(diagnosis: Mapping[str, Any], names: Sequence[str]) -> list[int]:
    """Indices of at most three joints that the answer names, else of the joint with the largest residual relative to its noise."""
    named = [e.get("joint") for e in [*diagnosis.get("effects", []), *diagnosis.get("unexplained", [])]]
    found = [names.index(joint) for joint in dict.fromkeys(named) if joint in names]
    if found:
        return found[:3]
    gap = diagnosis.get("gap") or {}
    before = over_noise(gap).get("before", np.zeros(0))
    if not np.isfinite(before).any():  # without a noise to compare with, the joint whose residual the answer lowers most
        rows = [np.array(gap.get(key, ()), dtype=float) for key in ("before", "after")]
        before = rows[0] / np.maximum(rows[1], 1e-12) if len(rows[0]) == len(rows[1]) else before
    return [names.index(gap["joints"][int(np.nanargmax(before))])] if np.isfinite(before).any() else [0]
