"""The page of `calib identify`: how well the fit predicts logs that it has not seen, and every parameter with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims import capital
from calib.report import explorer, pictures
from calib.report.page import Page, mark_of
from calib.terminal.quantity import printed_unit, significant
from logs.normal import INTERVAL
from sim.arm import Arm


def write(path: str | Path, result: Mapping[str, Any], evidence: Mapping[str, Any], arm: Arm | None = None) -> Path:
    """Write the page of a fit; returns its path.

    result    `FitResult.as_dict()`: the content of result.json
    evidence  `joint_names`; `log`; `t` (N,) s; `tau`, `before`, `after`, `q`, `dq` (N, n) on a held-out log, or else a training log
    arm       for the interactive curves and the arm in 3D, which are left out without it
    """
    held_out = result.get("holdout") is not None
    findings = list(result.get("findings", []))
    first, *more = [c["sentence"] for c in result.get("claims", []) if c["sentence"] not in findings] or [result["outcome"]]
    page = Page(result["arm"], capital(first), mark_of(result), _facts(result), "identification")
    if more or findings:
        page.aside("What to know about it", [capital(s) for s in (*more, *findings)])
    names = list(evidence["joint_names"])
    t, tau, q, dq = (np.asarray(evidence[k], float) for k in ("t", "tau", "q", "dq"))
    predicted = {role: np.asarray(evidence[role], float) for role in ("before", "after")}
    if arm is not None:
        page.section("Look at the residual")
        explorer.add(page, arm, [evidence], ("before", "after"), {"before": "nominal arm", "after": "identified arm"})
    seen = "a log that the fit had not seen" if held_out else "a log of the fit itself (no log was held out)"
    page.section("Torque, measured and predicted").figure(
        pictures.torques(names, t, tau, predicted),
        f"On {evidence['log']}, {seen}: the nominal arm (before) and the fitted one (after).",
    )
    residuals = {role: tau - value for role, value in predicted.items()}
    worst = int(np.argmax(np.sqrt(np.mean(residuals["after"] ** 2, axis=0)) / (np.std(tau, axis=0) + 1e-12)))
    page.figure(
        pictures.where(
            names[worst], t, q[:, worst], dq[:, worst], predicted["after"][:, worst],
            {role: value[:, worst] for role, value in residuals.items()},
        ),
        f"Residual at {names[worst]}, the joint with the largest share: structure here is missing from the model; calib diagnose can identify it.",
    )  # fmt: skip
    _gaps(page, result)
    _parameters(page, result)
    if result.get("advice"):
        page.section("What to record next").table(
            ["motion", "would identify"], [[m, ", ".join(names)] for m, names in result["advice"]]
        )
    excluded = result.get("excluded") or []
    if excluded:
        page.section("What was left out, and why").table(["log", "joint", "reason", "seconds"], excluded)
    settings = result.get("settings") or {}
    if settings:
        page.table(["setting", "value"], [[k, str(v)] for k, v in settings.items()], "Settings of the fit", fold=True)
    return page.write(path)


def _facts(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    gap = result["holdout"] or result["training"]
    known = [share for share in _shares(gap) if share is not None]
    estimates = result["estimates"]
    return [
        (
            "residual share, worst joint" + ("" if result["holdout"] else " (training)"),
            f"{max(known):.1%}" if known else "unknown",
        ),
        ("condition number", significant(result["condition"], 3)),
        ("identified", f"{sum(bool(e['identifiable']) for e in estimates)} of {len(estimates)} base parameters"),
        ("held-out logs", ", ".join(gap["logs"]) if result["holdout"] else "none"),
    ]


def _shares(gap: Mapping[str, Any]) -> list[float | None]:
    """Residual over the torque's standard deviation, joint by joint; None for a joint that stands."""
    pairs = zip(gap["sliding"] or gap["after"], gap["signal"], strict=True)
    return [left / signal if left is not None and signal else None for left, signal in pairs]


def _gaps(page: Page, result: Mapping[str, Any]) -> None:
    page.section("Residual, joint by joint")
    for key, title in (("holdout", "held-out logs"), ("training", "training logs")):
        gap = result.get(key)
        if gap is None:
            continue
        ampere = gap.get("after_ampere") is not None
        between = gap.get("noise")
        headers = [
            "joint",
            "before [N m]",
            "after [N m]",
            "sliding [N m]",
            "torque std [N m]",
            "residual share",
            *([] if between is None else ["between periods [N m]"]),
        ]
        rows = []
        for k, (joint, share) in enumerate(zip(result["joint_names"], _shares(gap), strict=True)):
            slid, signal = (gap["sliding"] or gap["after"])[k], gap["signal"][k]
            row = [joint, gap["before"][k], gap["after"][k], slid, signal, None if share is None else f"{share:.1%}"]
            row += [] if between is None else [between[k]]
            rows.append([*row, gap["before_ampere"][k], gap["after_ampere"][k]] if ampere else row)
        page.table(
            [*headers, "before [A]", "after [A]"] if ampere else headers,
            rows,
            f"RMS torque residual on the {title}: {', '.join(gap['logs'])}",
        )


def _parameters(page: Page, result: Mapping[str, Any]) -> None:
    estimates = [e for e in result["estimates"] if e["identifiable"] and e["nominal"] is not None and (e["std"] or 0) > 0]
    page.section("Parameters")
    if estimates:
        numbers = (np.array([e[k] for e in estimates], float) for k in ("value", "std", "nominal"))
        page.figure(
            pictures.intervals([_label(e) for e in estimates], *numbers),
            "Change of each parameter from nominal, in standard deviations, with 95 % intervals.",
        )
    laws: list[dict[str, str]] = next(
        (claim["laws"] for claim in result.get("claims", []) if claim["claim"] == "friction_laws"), []
    )
    if laws:
        page.table(
            ["joint", "friction law [N m]"],
            [[x["joint"], x["formula"]] for x in laws],
            "z(w): dry friction that builds up over w rad",
        )
    headers = ["parameter", "joint", "estimate", "± std", "95 % from", "to", "nominal", "unit", "from the data", "note"]
    for key, title in (("estimates", "Identified combinations"), ("full", "Physically consistent inertias of every link")):
        if not result.get(key):
            continue
        rows = [
            [e["name"], e["joint"], *_numbers(e), e["nominal"], printed_unit(str(e["unit"])), f"{e['data_share']:.0%}", _note(e, key == 'full')]
            for e in result[key]
        ]  # fmt: skip
        page.table(headers, rows, title, fold=key == "full")


def _label(estimate: Mapping[str, Any]) -> str:
    name = str(estimate["name"])
    return f"{name[:60]}…" if len(name) > 60 else name


def _numbers(estimate: Mapping[str, Any]) -> list[float | None]:
    """Value, standard deviation and interval; no value or deviation if the data alone put it below its bound."""
    if estimate["lower"] is not None and estimate["value"] < estimate["lower"]:
        return [None, None, estimate["lower"], max(_edge(estimate, 1) or 0.0, estimate["lower"])]
    return [estimate["value"], estimate["std"], _edge(estimate, -1), _edge(estimate, 1)]


def _edge(estimate: Mapping[str, Any], side: int) -> float | None:
    return None if estimate["std"] is None else estimate["value"] + side * INTERVAL * estimate["std"]


def _note(estimate: Mapping[str, Any], of_link: bool) -> str:
    single = " by itself" if of_link else ""  # torques depend on combinations of the links' parameters
    notes = [] if estimate["identifiable"] else [f"not identifiable from this data{single}"]
    written, std = estimate.get("written"), estimate["std"]
    if written is not None and std is not None and abs(written - estimate["value"]) > std:
        notes.append(f"written {written:.4g}, to be physically consistent")
    return ", ".join([*notes, "at its bound"] if estimate["at_bound"] else notes)
