"""The claims of a diagnosis, from its answer (diagnosis.json)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.claims.claim import Claim
from calib.claims.diagnosis_sentences import CONTACT, above_noise

FAR = 3.0  # times a parameter's tolerance
VERDICT = ("bad_data", "complete", "none_accepted", "unchanged", "missing", "changed", "unexplained")
# start of the names in `calibration` that are ripples of a gear
RIPPLE = "gear ripple"
REMARKS = ("driving", "removed", "motion", "held", "law", "possible", "refused", "ripple", "refit")


def claims(answer: Mapping[str, Any]) -> tuple[Claim, ...]:
    """The verdict first; then what the corrected arm gains, what cannot be distinguished, laws, refused effects, and what a refit alone moves."""
    out = [verdict(answer)]
    corrected = answer.get("effects") and answer.get("arm_out") and "baseline" not in answer
    if corrected and (gain := _removed(answer)):
        out.append(gain)
        if answer.get("motion"):
            out.append(_motion(answer["motion"]))
        out += _held(answer["effects"])
    if answer.get("driving"):
        out.append(Claim("driving", {"joints": answer["driving"]}))
    out += [
        Claim("alike", {"effect": e["effect"], "joint": e["joint"], "others": e["indistinguishable_from"]})
        for e in answer.get("effects", [])
        if e.get("indistinguishable_from")
    ]
    keys = ("joint", "formula", "rms_without", "rms_with")
    out += [Claim("law", {key: law[key] for key in keys}) for law in answer.get("laws", [])]
    keys = ("effect", "joint", "chance", "experiment")
    simulated = {"simulated": (answer.get("false_names") or {}).get("simulated")}
    out += [Claim("possible", {key: x[key] for key in keys} | simulated) for x in answer.get("possible", [])]
    out += [Claim("refused", {"text": text}) for text in answer.get("refused", [])]
    moved = answer.get("calibration", [])
    if ripples := [m for m in moved if m["name"].startswith(RIPPLE)]:
        out.append(Claim("ripple", {"parameters": sorted(ripples, key=lambda m: -m["gap_share"])}))
    far = [m for m in moved if abs(m["to"] - m["from"]) > FAR * m["prior_std"]]
    return (*out, Claim("refit", {"parameters": far})) if far else tuple(out)


def verdict(answer: Mapping[str, Any]) -> Claim:
    """The verdict as a claim."""
    kind, healthy = answer["verdict"], answer.get("baseline")
    keys = ("effect", "joint", "parameters", "confidence", "gap_share", "measured_by", "log")
    effects = [
        {key: e[key] for key in keys if key in e}
        | ({"others": others} if (others := e.get("indistinguishable_from")) else {})
        | ({"residual": left} if (left := residual_at(answer, e)) else {})
        for e in answer.get("effects", [])
    ]
    if kind == "bad_data":
        return Claim("bad_data", {"failed": [c["detail"] for c in answer.get("data_checks", []) if not c["ok"]]})
    if kind == "unexplained":
        return Claim("unexplained", {"joints": answer.get("unexplained", []), "effects": effects})
    if kind == "effects_found":
        return Claim("missing" if healthy is None else "changed", {"effects": effects})
    if healthy is not None:
        return Claim("unchanged", {"arm": answer["arm"], "healthy": len(healthy)})
    if answer.get("refused"):
        return Claim("none_accepted", {"arm": answer["arm"]})
    return Claim("complete", {"arm": answer["arm"]} | agreement(answer.get("gap") or {}))


def disagrees(answer: Mapping[str, Any]) -> bool:
    """Whether no effect is identified although the model disagrees with the log: all candidates are refused, or a residual above the noise remains."""
    claim = verdict(answer)
    return claim.name == "none_accepted" or (claim.name == "complete" and above_noise(claim.numbers))


def over_noise(gap: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """{"before", "refit", "after"}: (n,) residual RMS over the noise, NaN for a joint without either; {} if no noise was measured.

    Over the rows in which a joint slides, as the noise is; over all rows in an answer that does not separate them.
    """
    noise, of = np.array(gap.get("noise_floor", []), dtype=float), gap.get("sliding") or gap
    found = {key: np.array(of.get(key, []), dtype=float) for key in ("before", "refit", "after")}
    if not len(noise) or not (noise > 0).all():
        return {}
    return {key: x / noise for key, x in found.items() if len(x) == len(noise)}


def agreement(gap: Mapping[str, Any]) -> dict[str, Any]:
    """The joint with the largest ratio of residual after a refit to noise; log, joint and ratio are None if no noise was measured."""
    ratio = over_noise(gap).get("refit", np.zeros(0))
    if not np.isfinite(ratio).any():
        return {"log": None, "joint": None, "ratio": None}
    k = int(np.nanargmax(ratio))
    return {"log": gap["log"], "joint": gap["joints"][k], "ratio": float(ratio[k])}


def _motion(pairs: Sequence[Mapping[str, Any]]) -> Claim:
    """The flange's error over the longest horizon that was simulated."""
    pair = max(pairs, key=lambda p: float(p["after"]["horizon_s"]))
    ends = {when: pair[when]["flange_m"] for when in ("before", "after")}
    return Claim("motion", {"horizon_s": float(pair["after"]["horizon_s"]), "loop": pair["after"]["loop"], **ends})


def _held(effects: Sequence[Mapping[str, Any]]) -> list[Claim]:
    """Per effect the parameters whose value in the corrected arm is more than a standard deviation from the fitted one."""
    out = []
    for e in effects:
        apart = {
            k: p
            for k, p in e["parameters"].items()
            if "written" in p and abs(p["written"] - p["value"]) > (p["std"] or 0.0) > 0
        }
        if apart:
            parameters = [{"name": k, "value": p["written"], "unit": p["unit"]} for k, p in apart.items()]
            out.append(Claim("held", {"effect": e["effect"], "joint": e["joint"], "parameters": parameters}))
    return out


def _removed(answer: Mapping[str, Any]) -> Claim | None:
    """The joint whose residual the corrected arm lowers most; None if nothing was compared."""
    gap = answer.get("gap") or {}
    left = _before_and_after(gap, None)
    return Claim("removed", {"log": gap["log"], **left}) if left else None


def residual_at(answer: Mapping[str, Any], effect: Mapping[str, Any]) -> dict[str, Any] | None:
    """Residual RMS before and after at an effect's joint, for an effect of the whole arm at the joint where it falls most.

    All effects and the parameter refit are in the second number. None if nothing was compared or corrected, or if the torque
    does not show the effect.
    """
    left = _before_and_after(answer.get("gap") or {}, effect["joint"])
    if left is None or left["before"] == left["after"] or not effect["gap_share"] > 0.0:
        return None
    return left | {"healthy": "baseline" in answer}


def _before_and_after(gap: Mapping[str, Any], joint: str | None) -> dict[str, Any] | None:
    """Residual RMS at a joint, or where it falls most; None if nothing was compared."""
    before, after = (np.array(gap.get(key, []), dtype=float) for key in ("before", "after"))
    if not len(before) or len(before) != len(after):
        return None
    k = int(np.argmin(after / np.maximum(before, 1e-300))) if joint is None else list(gap["joints"]).index(joint)
    return {"joint": gap["joints"][k], "before": float(before[k]), "after": float(after[k]), "unit": gap["unit"]}


def is_corrected(diagnosis: Mapping[str, Any]) -> bool:
    """Whether the diagnosis wrote an arm that differs from the given one."""
    return bool(diagnosis.get("arm_out") and (lasting(diagnosis) or diagnosis.get("laws")))


def lasting(diagnosis: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The identified effects except contacts, which are not a property of the arm."""
    return [e for e in diagnosis.get("effects", []) if e["effect"] != CONTACT]
