"""The page of `calib validate`: does the model predict what the arm did, by torque and by forward simulation?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims import capital
from calib.report import explorer, pictures
from calib.report.page import Page, Verdict, mark_of
from sim.arm import Arm

_WORDS = {"after": "predicted torque"}


def write(path: str | Path, result: Mapping[str, Any], evidence: Sequence[Mapping[str, Any]], arm: Arm | None = None) -> Path:
    """Write the page of a validation; returns its path.

    result    `Validation.as_dict()`: the content of validation.json
    evidence  for each log `log`; `t` (N,) s; `tau`, `tau_hat`, `q`, `dq` (N, n)
    arm       for the interactive curves and the arm in 3D, which are left out without it
    """
    names = list(result["joints"])
    first, *more = [str(c["sentence"]) for c in result.get("claims", [])] or [str(result["outcome"])]
    page = Page(str(result["arm"]), capital(first), _verdict(result), _facts(result), "validation")
    if more:
        page.aside("What to know about it", [capital(s) for s in more])
    if arm is not None:
        page.section("Look at the residual")
        explorer.add(page, arm, [dict(c) | {"after": c["tau_hat"]} for c in evidence], ("after",), _WORDS)
    for curves in evidence:
        _curves(page, names, curves)
    page.section("Joint by joint")
    for entry in result["logs"]:
        forward = entry.get("forward")
        headers = ["joint", "residual [N m]", "sliding [N m]", "torque std [N m]", "residual share"]
        if forward:
            headers += [f"error after {forward['horizon_s']:g} s [mrad]", "bound [mrad]", "travel [mrad]"]
        rows = []
        for k, joint in enumerate(names):
            row = [joint, entry["residual"][k], entry["residual_sliding"][k], entry["signal"][k], _percent(entry, k)]
            bound = (forward or {}).get("bound") or [None] * len(names)
            rows.append(row + ([_milli(forward["rms"][k]), _milli(bound[k]), _milli(forward["travel"][k])] if forward else []))
        note = f"; simulated forward from {forward['windows']} states under the measured torque" if forward else ""
        if forward and forward.get("bound_from"):
            note += f"; the bound should hold in 95 % of logs, from what {forward['bound_from']}"
        page.table(headers, rows, f"RMS on {entry['log']}{note}")
    left_out = [[entry["log"], *item] for entry in result["logs"] for item in entry["excluded"]]
    if left_out:
        page.section("What was left out, and why").table(["log", "joint", "reason", "seconds"], left_out)
    return page.write(path)


def _curves(page: Page, names: Sequence[str], curves: Mapping[str, Any]) -> None:
    t, tau, tau_hat, q, dq = (np.asarray(curves[k], float) for k in ("t", "tau", "tau_hat", "q", "dq"))
    if not len(t):  # no row of the log was usable; the table shows this
        return
    page.section(f"Torque, measured and predicted: {curves['log']}").figure(
        pictures.torques(names, t, tau, {"after": tau_hat}, words=_WORDS), f"On {curves['log']}."
    )
    left = tau - tau_hat
    worst = int(np.argmax(np.sqrt(np.mean(left**2, axis=0)) / (np.std(tau, axis=0) + 1e-12)))
    page.figure(
        pictures.where(names[worst], t, q[:, worst], dq[:, worst], tau_hat[:, worst], {"after": left[:, worst]}),
        f"Residual at {names[worst]}, the joint with the largest share; a slope, a step or a wave has a cause that calib diagnose can identify.",
    )


def _facts(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    facts: list[tuple[str, Any]] = [("logs", ", ".join(e["log"] for e in result["logs"]))]
    shares = [(_share(e, k), joint) for e in result["logs"] for k, joint in enumerate(result["joints"])]
    known = [(share, joint) for share, joint in shares if share is not None]
    if known:
        share, joint = max(known)
        facts.append(("residual share, worst joint", f"{share:.1%} ({joint})"))
    return facts


def _share(entry: Mapping[str, Any], k: int) -> float | None:
    """Residual of the sliding joint over signal; None if the joint did not move or none of its rows was usable."""
    left, signal = entry["residual_sliding"][k], entry["signal"][k]
    return left / signal if left is not None and signal else None


def _percent(entry: Mapping[str, Any], k: int) -> str | None:
    share = _share(entry, k)
    return None if share is None else f"{share:.1%}"


def _milli(value: float | None) -> float | None:
    return None if value is None else 1000 * value


def _verdict(result: Mapping[str, Any]) -> Verdict | None:
    """The mark before the headline; None if nothing was compared with a limit."""
    return mark_of(result) if "verdict" in result else None
