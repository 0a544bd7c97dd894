"""The page of `calib validate`: does the arm's model say what the arm did, by torque and by forward simulation?"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib.report import pictures
from calib.report.page import Page, Verdict

_WORDS = {"after": "predicted"}


def write(path: str | Path, result: Mapping[str, Any], evidence: Mapping[str, Any], verdict: Verdict | None = None) -> Path:
    """Write the page of a validation; returns its path.

    result    `arm`, `outcome` (a sentence), `joints`, and `logs`: for each `log`, `rms`, `signal` (n,) N m of torque and, where the
              model was simulated forward, `forward_rms` (n,) rad and `forward_seconds` s
    evidence  `log`; `t` (N,) s; `tau`, `tau_hat`, `q`, `dq` (N, n); where simulated forward `t_forward` (M,), `q_forward`,
              `q_hat_forward` (M, n) rad
    """
    names = list(result["joints"])
    t, tau, tau_hat, q, dq = (np.asarray(evidence[k], float) for k in ("t", "tau", "tau_hat", "q", "dq"))
    page = Page(str(result["arm"]), str(result["outcome"]), verdict, _facts(result), "validation")
    page.section("Torque, measured and predicted").figure(
        pictures.torques(names, t, tau, {"after": tau_hat}, words=_WORDS), f"On {evidence['log']}."
    )
    left = tau - tau_hat
    worst = int(np.argmax(np.sqrt(np.mean(left**2, axis=0)) / (np.std(tau, axis=0) + 1e-12)))
    page.figure(
        pictures.where(names[worst], t, q[:, worst], dq[:, worst], tau_hat[:, worst], {"after": left[:, worst]}),
        f"What is left at {names[worst]}, the joint with most left; a slope, a step or a wave has a cause that calib diagnose can name.",
    )
    if evidence.get("t_forward") is not None:
        page.section("Position in forward simulation").figure(
            pictures.torques(
                names, np.asarray(evidence["t_forward"]), np.asarray(evidence["q_forward"]),
                {"after": np.asarray(evidence["q_hat_forward"])}, "rad", {"after": "simulated"},
            ),
            "The model is driven as the arm was; it must go where the arm went.",
        )  # fmt: skip
    page.section("Joint by joint")
    for entry in result["logs"]:
        forward = entry.get("forward_rms")
        headers = ["joint", "residual [N m]", "torque [N m]", "left", *(["forward [mrad]"] if forward is not None else [])]
        rows = [
            [joint, entry["rms"][k], entry["signal"][k], f"{entry['rms'][k] / entry['signal'][k]:.1%}"]
            + ([1000 * forward[k]] if forward is not None else [])
            for k, joint in enumerate(names)
        ]
        page.table(headers, rows, f"RMS on {entry['log']}")
    return page.write(path)


def _facts(result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    share = np.array([np.asarray(e["rms"], float) / np.asarray(e["signal"], float) for e in result["logs"]])
    j = int(np.argmax(share.max(axis=0)))
    return [
        ("logs", ", ".join(e["log"] for e in result["logs"])),
        ("left of the torque, worst joint", f"{share.max():.1%} ({result['joints'][j]})"),
    ]
