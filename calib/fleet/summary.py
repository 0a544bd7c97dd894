"""The summary of a fleet: the sentence, the table of all arms, and which arms deviate, in what, by how much and since when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.claims.diagnosis_sentences import quantity, words
from calib.fleet.fleet import Fleet, deviates
from calib.fleet.job import ArmStatus
from calib.fleet.siblings import LEAST, OUTLIER


def sentence(fleet: Fleet) -> str:
    """The fleet in one sentence."""
    rows = fleet.rows
    done = [row for row in rows if row["status"] == "done"]
    deviating = [row for row in done if deviates(row)]
    text = f"{len(done)} of {len(rows)} arms assessed"
    blind = not_diagnosed(fleet)
    none = ", none deviates" if blind < len(done) else ""
    text += f", {len(deviating)} deviate{'s' if len(deviating) == 1 else ''}" if deviating else none
    models = "its model" if blind == 1 else "their models"
    text += f"; {blind} not diagnosed, so not compared with {models}" if blind else ""
    if alone := sum(row.get("outlier_score") is None for row in done):
        of = f"{alone} arm{'s' * (alone != 1)}"
        text += f"; the friction, masses and inertias of {of} are fitted and compared with no siblings ({LEAST} arms of a model are the least)"
    if len(done) < len(rows):
        text += f"; {len(rows) - len(done)} could not be assessed"
    if fleet.unassigned:
        few = len(fleet.unassigned) == 1
        text += (
            f"; {len(fleet.unassigned)} recording{' does' if few else 's do'} not say whose {'it is' if few else 'they are'}"
        )
    return text


def not_diagnosed(fleet: Fleet) -> int:
    """Number of arms that were identified but not compared with their models."""
    return sum(row.get("verdict") == "not_diagnosed" for row in fleet.rows)


def nothing_wrong(fleet: Fleet) -> bool:
    """Whether all that was requested could be done for the arm of every recording, and none deviates."""
    # a diagnosis that was not requested is no failure; one that could not be made is
    done = all(row["status"] == "done" and not row.get("diagnosis_trouble") for row in fleet.rows)
    return done and not fleet.unassigned and not any(deviates(row) for row in fleet.rows)


def arm_rows(fleet: Fleet) -> list[list[Any]]:
    """Arm, status, recordings, minutes, largest unexplained share of torque, verdict, parameter farthest from the siblings'."""
    return [
        [
            row["arm"], row["status"].replace("_", " "), _used(row), row["seconds"] / 60 if row.get("seconds") else None,
            _worst(row), str(row.get("verdict") or "").replace("_", " "), _farthest(row),
        ]
        for row in fleet.rows
    ]  # fmt: skip


def deviation_rows(fleet: Fleet) -> list[list[Any]]:
    """Arm, what, joint, how large, since when.

    One line for every named effect, joint with structure without a name, model that does not agree, effect that only an unsearched part
    shows, and arm unlike its siblings.
    """
    out = []
    for row in fleet.rows:
        for e in row.get("effects") or ():
            size = ", ".join(f"{p['name'].replace('_', ' ')} {quantity(p)}" for p in e["parameters"])
            out.append([row["arm"], words(e["effect"], None), e["joint"] or "whole arm", size, since(e)])
        out += [[row["arm"], "something without a name", joint, "", ""] for joint in row.get("unexplained") or ()]
        if row.get("disagrees"):
            out.append([row["arm"], "the model does not agree, and no effect is identified", "", "", ""])
        if row.get("elsewhere"):
            out.append(
                [row["arm"], f"looks like {row['elsewhere'].replace('_', ' ')}, in a part that was not searched", "", "", ""]
            )
        if abs(row.get("outlier_score") or 0.0) > OUTLIER:
            out.append([row["arm"], "unlike its siblings", "", _farthest(row), ""])
    return out


def refit_rows(fleet: Fleet) -> list[list[str]]:
    """Arm, and what a refit moved beyond the tolerances, for which `calib diagnose` names no effect."""
    return [[row["arm"], row["refit"]] for row in fleet.rows if row.get("refit")]


def trouble_rows(fleet: Fleet) -> list[list[str]]:
    """Arm, status, why: arms that could not be assessed, and recordings that could not be used."""
    out = [
        [row["arm"], ArmStatus[row["status"].upper()].value, row["sentence"]] for row in fleet.rows if row["status"] != "done"
    ]
    out += [[row["arm"], "left out", bad] for row in fleet.rows if row["status"] == "done" for bad in row["bad_logs"]]
    out += [[row["arm"], "not diagnosed", row["diagnosis_trouble"]] for row in fleet.rows if row.get("diagnosis_trouble")]
    return out + [["", "recording of no arm", why] for _, why in fleet.unassigned]


def since(effect: Mapping[str, Any]) -> str:
    """Since when an effect has been there, as far as the longest piece of each older recording and of the newest session shows."""
    when = str(effect["since"])[:10]
    if not when:
        return "not seen alone"
    return f"since {when}" if effect["began"] else f"since {when} at the latest"


def _used(row: Mapping[str, Any]) -> int | str:
    """Number of recordings used, with the total if any was left out; for an arm that was not assessed, the total."""
    there, left_out = len(row["logs"]), len(row["bad_logs"]) if row["status"] == "done" else 0
    return f"{there - left_out} of {there}" if left_out else there


def _worst(row: Mapping[str, Any]) -> str:
    left = np.array(row.get("left_of_torque") or [np.nan], dtype=float)
    return f"{np.nanmax(left):.1%}" if np.isfinite(left).any() else ""


def _farthest(row: Mapping[str, Any]) -> str:
    if row.get("outlier_score") is None:
        return ""
    return f"{row['outlier_parameter'].split(' ')[0]}, {row['outlier_score']:+.1f} standard deviations"
