"""The evidence for the answer of a diagnosis: effects, candidates, and the residual in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calib.claims.diagnosis_sentences import listed, variable, words
from calib.claims.of_diagnosis import residual_at
from calib.report import pictures
from calib.report.page import Page
from calib.terminal.quantity import pair, significant
from calib.terminal.quantity import printed_unit as unit_of


def add_evidence(page: Page, diagnosis: Mapping[str, Any], evidence: Mapping[str, Any]) -> None:
    effects = diagnosis.get("effects", [])
    if effects:
        page.section("Identified effects")
        parameters = [(e, k, p) for e in effects for k, p in e["parameters"].items()]
        apart = any(_written(p) != pair(p["value"], p.get("std"))[0] for _, _, p in parameters if "written" in p)
        rows = [
            [words(e["effect"], None), e.get("joint") or "whole arm", _symbol(k), *_value(p),
             *([_written(p)] if apart else []), p.get("nominal"), unit_of(p.get("unit", "")), _residual(diagnosis, e), f"{e['confidence']:.0%}"]
            for e, k, p in parameters
        ]  # fmt: skip
        page.table(
            ["effect", "joint", "parameter", "value", "± std", *(["in the arm folder"] if apart else []), "nominal", "unit",
             f"residual RMS [{unit_of(diagnosis['gap']['unit'])}]", "confidence"],
            rows,
            f"Residual RMS: before → after, on {diagnosis['gap']['log']}, with all effects in the second number",
        )  # fmt: skip
        if apart:
            page.text(
                "The value is the estimate of the fit. An arm folder cannot hold a lead of the torque reading or of dry friction, so it predicts "
                "best with slightly different numbers."
            )
    candidates = evidence.get("candidates") or []
    if candidates:
        chosen = {(e["effect"], e.get("joint")) for e in effects}
        page.section("Why this effect, and what else it could be" if effects else "What was looked for").figure(
            pictures.evidence(
                [words(effect, joint) for effect, joint, _ in candidates],
                [float(score) for _, _, score in candidates],
                [(effect, joint) in chosen for effect, joint, _ in candidates],
                float(evidence["threshold"]),
            ),
            "Every effect of the catalogue was tried at every joint; the best are shown, the chosen ones filled. A "
            "candidate close to a chosen one often explains the same residual, and drops once the right effect is in the model.",
        )
        page.table(
            ["effect", "joint", "evidence", "chosen"],
            [
                [words(effect, None), joint or "whole arm", float(score), (effect, joint) in chosen]
                for effect, joint, score in candidates
            ],
            "Candidates and their evidence in numbers",
            fold=True,
        )
    if diagnosis.get("unexplained"):
        page.section("What no effect explains").table(
            ["joint", "depends on", "RMS", "unit"],
            [
                [u["joint"], listed([variable(v) for v in u["depends_on"]]), u["rms"], unit_of(u["unit"])]
                for u in diagnosis["unexplained"]
            ],
        )
    laws = diagnosis.get("laws") or []
    if laws:
        page.section("Friction laws fitted where no catalogue effect fits").table(
            ["joint", "torque [N m]", "RMS without it", "RMS with it", "unit"],
            [[x["joint"], x["formula"], x["rms_without"], x["rms_with"], unit_of(x["unit"])] for x in laws],
            "On recordings left out of its fit; z(w): dry friction that builds up over w rad",
        )


def gap_columns(gap: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Column title -> a number per joint, for the columns that the answer has."""
    columns = {"before": gap["before"], "after parameter refit": gap.get("refit"), "after": gap["after"]}
    columns |= {"after, sliding": (gap.get("sliding") or {}).get("after")}
    columns |= {"given arm": gap.get("given_arm"), "corrected arm": gap.get("corrected_arm")}
    return {title: values for title, values in columns.items() if values}


def gap_title(diagnosis: Mapping[str, Any]) -> str:
    """The title of the residual table."""
    unit, log = unit_of(diagnosis["gap"]["unit"]), diagnosis["gap"]["log"]
    if "baseline" in diagnosis:
        return f"RMS [{unit}] on {log} of the residual that the healthy recordings do not explain"
    return f"residual RMS [{unit}] on {log}"


def gap_caption(diagnosis: Mapping[str, Any]) -> str:
    """The caption of the residual table, with the meaning of its columns."""
    gap = diagnosis["gap"]
    if "baseline" in diagnosis:
        text = f"RMS on {gap['log']} of the residual that the healthy recordings do not explain, without and with the changes"
        return text + (
            "; “given arm”, “corrected arm”: the residual RMS of their own predictions" if "given_arm" in gap else ""
        )
    caption = f"Residual RMS on {gap['log']}; “after parameter refit”: ordinary parameters fitted, no effect added"
    if gap.get("sliding"):
        caption += (
            "; “sliding”: without changes of direction, where dry friction can hold any torque and no noise can be measured"
        )
    return caption


def add_gap(page: Page, diagnosis: Mapping[str, Any]) -> None:
    gap = diagnosis.get("gap") or {}
    if gap.get("before"):
        unit = unit_of(gap["unit"])
        columns = gap_columns(gap) | {"noise floor": gap["noise_floor"] or ["not measured"] * len(gap["joints"])}
        rows = [list(row) for row in zip(gap["joints"], *columns.values(), strict=True)]
        page.section("The residual in numbers").table(
            ["joint", *(f"{title} [{unit}]" for title in columns)], rows, gap_caption(diagnosis)
        )
    motion = diagnosis.get("motion") or []
    if motion:
        rows = [
            [
                f"{pair['before']['horizon_s']:g} s, {pair['before']['loop']} loop",
                *(_thousandths([pair[when]["flange_m"]]) for when in ("before", "after")),
                *(_thousandths(pair[when]["angle_rad"]) for when in ("before", "after")),
            ]
            for pair in motion
        ]
        page.table(
            [
                "simulated for",
                "flange before [mm]",
                "flange after [mm]",
                "worst joint before [mrad]",
                "worst joint after [mrad]",
            ],
            rows,
            "RMS error of the motion simulated under the measured torque",
        )


def _residual(diagnosis: Mapping[str, Any], effect: Mapping[str, Any]) -> str | None:
    """Residual RMS before → after at the effect's joint; for an effect of the whole arm with the joint where it falls most."""
    left = residual_at(diagnosis, effect)
    if left is None:
        return None
    text = f"{significant(left['before'], 3)} → {significant(left['after'], 3)}"
    return text if effect.get("joint") else f"{text} at {left['joint']}"


def _thousandths(errors: Sequence[float | None]) -> float | str:
    """The largest error in mm or mrad; "unstable" if one is unknown."""
    known = [x for x in errors if x is not None]
    return 1e3 * max(known) if len(known) == len(errors) else "unstable"


def _symbol(parameter: str) -> str:
    return parameter.replace("_", " ")


def _value(parameter: Mapping[str, Any]) -> tuple[float | None, float | str | None]:
    """The fitted value and its standard deviation, for two columns."""
    value, std = pair(parameter["value"], parameter.get("std"))
    return value, "not identifiable" if parameter.get("identifiable") is False else std


def _written(parameter: Mapping[str, Any]) -> float | None:
    """The value in the corrected arm, rounded like the fitted one; None if the arm does not hold it."""
    return pair(parameter.get("written"), parameter.get("std"))[0]
