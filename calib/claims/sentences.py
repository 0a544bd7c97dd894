"""The sentence of every kind of claim, made from its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from calib.claims import diagnosis_sentences as diagnosis
from calib.terminal.quantity import percentages, significant, significant_beside

MOST_NAMES = 4
Numbers = Mapping[str, Any]


def _some(names: Sequence[str]) -> str:
    more = len(names) - MOST_NAMES
    names = [name.split(" ")[0] for name in names]  # a base parameter by its first term
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} other{'s' if more > 1 else ''}" if more > 0 else "")


def _residual(n: Numbers) -> str:
    if n["worst"] is None:
        return f"nothing compared: no joint of {n['arm']} moves long enough in {n['where']} with a torque that the arm can have"
    left, limit = percentages(n["left"], n["limit"])
    verdict = "wrong arm or wrong model" if n["verdict"] == "wrong arm" else n["verdict"]
    sentence = (
        f"{verdict}: at {n['worst']}, the worst joint, the residual RMS of {n['arm']} while sliding is {left} of the torque "
        f"std in {n['where']} (limit {limit})"
    )
    others = [joint for joint in n["beyond"] if joint != n["worst"]]
    sentence += f"; also above their limits: {_some(others)}" if others else ""
    return sentence + (f"; not compared: {_some(n['uncompared'])}" if n["uncompared"] else "")


def _worse(n: Numbers) -> str:
    rows = [f"{r['joint']} ({significant(r['before'], 3)} -> {significant(r['after'], 3)} N m)" for r in n["joints"]]
    return f"the residual RMS is higher than with the nominal parameters at {', '.join(rows)}"


def _moved(n: Numbers) -> str:
    return (
        f"{len(n['names'])} not identifiable but changed along with the others, {_some([n['farthest']])} the most, "
        f"by {significant(n['most'])} times its nominal tolerance"
    )


def _of_parameters(text: str) -> Callable[[Numbers], str]:
    return lambda n: f"{_some([row['name'] for row in n['parameters']])}: {text}"


def _forward(n: Numbers) -> str:
    return (
        f"simulated forward for {n['horizon']:g} s, the largest error is at {n['joint']}: {significant(n['off_deg'])} deg (RMS) over "
        f"{significant(n['travel_deg'])} deg of travel"
    )


def _unstable(n: Numbers) -> str:
    return (
        f"simulated forward for {n['horizon']:g} s under the measured torque, the arm is unstable in {_some(n['logs'])}, which "
        "happens if a friction law drives a joint or a joint is too light for its law; the torques are assessed nevertheless"
    )


def _bounds(n: Numbers) -> str:
    parts = []
    if n["beyond"]:
        texts = [significant_beside(r["off_deg"], r["bound_deg"]) for r in n["beyond"]]
        rows = [
            f"{r['joint']} in {r['log']} ({off} deg, bound {bound})" for r, (off, bound) in zip(n["beyond"], texts, strict=True)
        ]
        parts.append(f"beyond the stated bound: {', '.join(rows)}")
    if n["within"]:
        everywhere = not n["beyond"] and not n["not_informative"]
        parts.append(f"within the stated bound at {'every joint' if everywhere else _some(n['within'])}")
    if n["not_informative"]:
        parts.append(f"the bound is not informative at {_some(n['not_informative'])}: it exceeds half of the travel")
    return "; ".join(parts)


def _separation(n: Numbers) -> str:
    enough = n["sigma"] >= n["enough"]
    more = (
        "" if enough else f", less than the {n['enough']:.0f} needed to distinguish them: give more room or a longer --period"
    )
    return f"the motion discriminate separates the candidate effects by {significant(n['sigma'], 3)} standard deviations{more}"


SENTENCES: dict[str, Callable[[Numbers], str]] = {
    "residual": _residual,
    "worse": _worse,
    "driving": diagnosis.driving,
    "friction_laws": lambda n: (
        f"{diagnosis.listed([law['joint'] for law in n['laws']])}: a friction law is added to Coulomb and viscous friction; its terms are in arm.toml and on the page"
    ),
    "unstated_drives": lambda n: (
        "nobody stated "
        + "; ".join(f"{' and '.join(words)} of {joint}" for joint, words in n["joints"].items())
        + ", so plans keep the motion slow: state them (`calib arm new --drive`) and plan again"
    ),
    "identified": lambda n: f"{len(n['names'])} of {n['of']} base parameters identified",
    "kept": lambda n: f"{len(n['names'])} not identifiable from these logs, held at nominal",
    "moved": _moved,
    "projected": _of_parameters("changed by more than the standard deviation to make the arm physically consistent"),
    "out_of_bounds": _of_parameters("the estimate is physically impossible; the value written is within bounds"),
    "condition": lambda n: f"condition number {significant(n['condition'], 3)}",
    "speed_reading": lambda n: (
        "the reported speed was used instead of the derivative of the position: it predicts held-out parts of the recordings better"
    ),
    "cutoff": lambda n: (
        f"the filter's cutoff is {n['cutoff_hz']:.3g} Hz, below the {n['motion_hz']:.3g} Hz of the motion: it predicts held-out parts of "
        "the recordings better"
    ),
    "information_gap": lambda n: (
        "another motion within the limits would reduce the standard deviations by at most "
        f"{n['share']:.0%} on average ({n['nats']:.1f} nats of log det, estimate)"
    ),
    "forward": _forward,
    "unstable": _unstable,
    "bounds": _bounds,
    "duration": lambda n: f"{n['seconds'] / 60:.1f} minutes of motion at full speed",
    "known": lambda n: f"{len(n['names'])} of {n['of']} parameters improve over their nominal values",
    "separation": _separation,
    "bad_data": diagnosis.bad_data,
    "complete": diagnosis.complete,
    "none_accepted": diagnosis.none_accepted,
    "unchanged": diagnosis.unchanged,
    "missing": diagnosis.missing,
    "changed": diagnosis.changed,
    "unexplained": diagnosis.unexplained,
    "law": diagnosis.law,
    "possible": diagnosis.possible,
    "refused": diagnosis.refused,
    "refit": diagnosis.refit,
    "ripple": diagnosis.ripple,
    "held": diagnosis.held,
    "alike": diagnosis.alike,
    "removed": diagnosis.removed,
    "motion": diagnosis.motion,
}
