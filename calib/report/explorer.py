"""The interactive part of a page: the arm in 3D with its links coloured by torque residual, zoomable curves with one cursor, effects to switch."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from calib.claims.diagnosis_sentences import words as effect_words
from calib.report.page import Page, asset, template
from calib.report.scene import scene
from sim.arm import Arm

MOST_ROWS = 1200
MOST_LOGS = 4
FRAMES_PER_SECOND = 12
WORDS = {"before": "nominal arm", "after": "corrected arm"}


def add(
    page: Page, arm: Arm, logs: Sequence[Mapping[str, Any]], roles: Sequence[str], words: Mapping[str, str] | None = None, unit: str = "N m",
    joint: str | None = None,
) -> Page:  # fmt: skip
    """Embed the interactive part in the page.

    logs   each with `log`, its name; `t` (N,) s; `tau`, `q`, `dq` (N, n), and (N, n) for each of `roles`: the predicted torque; optionally
           `switched`, the same effects for each log, as `calib.evidence.of_diagnosis` has them
    roles  `before`, `after`, or one of them; the links show the residual of the first
    words  what the roles are called; joint: the one shown first
    """
    shown = [_thinned(log, roles) for log in logs[:MOST_LOGS] if len(log["t"])]
    if not shown:
        return page
    names = list(arm.joint_names)
    label = (words or WORDS).get(roles[0], roles[0])
    moved = [_moved(log, roles[0]) for log in shown]
    step = max(float(np.median(np.diff(log["t"]))) for log in shown if len(log["t"]) > 1)
    data = {
        "joints": names, "joint": names.index(joint) if joint in names else _worst(shown, roles[0]), "roles": list(roles), "unit": unit,
        "words": {role: (words or WORDS).get(role, role) for role in ("before", "after")}, "step": step,
        "effects": [
            {"name": effect_words(e["effect"], e["joint"]), "joint": names.index(e["joint"]) if e["joint"] in names else None, "identified": e["identified"]}
            for e in shown[0]["switched"]
        ],
        "logs": [
            {"name": log["log"], "t": _short(log["t"]), **{k: _short(log[k]) for k in ("tau", "q", "dq", *roles)},
             "effects": [_changed(log, e) for e in log["switched"]]}
            for log in shown
        ],
    }  # fmt: skip
    return _embedded(page, scene(arm, None) | {"motions": moved, "heat": label}, data)


def copied(page: Page, report: Path) -> Page:
    """Embed the interactive part of another page of this program; nothing if it has none."""
    text = report.read_text(encoding="utf-8") if report.is_file() else ""
    found = [
        re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', text, re.DOTALL)
        for name in ("scene", "explorer")
    ]
    try:
        scene_data, data = (json.loads(part[1]) for part in found if part is not None)
        return _embedded(page, scene_data, data)
    except (ValueError, KeyError, TypeError):  # a page without it, or an edited one
        return page


def _embedded(page: Page, scene_data: Mapping[str, Any], data: Mapping[str, Any]) -> Page:
    options = Markup("").join(
        Markup('<option value="{0}">{0} · {1:.0f} s</option>').format(m["name"], float(m["t"][-1]))
        for m in scene_data["motions"]
    )
    heat = f"The redder a link, the larger the residual of the {scene_data['heat']} at its joint at this moment, relative to that joint's largest."
    page.embed(
        Markup(template("player.html").render(options=options)),
        asset("player.js"),
        asset("player.css"),
        {"scene": dict(scene_data)},
    )
    page.text(heat)
    return page.embed(
        Markup(template("explorer.html").render()), asset("explorer.js"), asset("explorer.css"), {"explorer": dict(data)}
    )


def _thinned(log: Mapping[str, Any], roles: Sequence[str]) -> dict[str, Any]:
    """At most MOST_ROWS rows of the filtered log, evenly spread."""
    count = len(log["t"])
    rows = np.unique(np.linspace(0, count - 1, min(count, MOST_ROWS)).astype(int))
    switched = [dict(e) | {"tau": np.asarray(e["tau"], float)[rows]} for e in log.get("switched", ())]
    return {
        "log": str(log["log"]), "switched": switched, **{k: np.asarray(log[k], float)[rows] for k in ("t", "tau", "q", "dq", *roles)}
    }  # fmt: skip


def _changed(log: Mapping[str, Any], effect: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Torque columns that the effect changes, by joint index; the others are those of the arm with which it is compared."""
    beside = log["after" if effect["identified"] else "before"]
    apart = np.abs(effect["tau"] - beside).max(axis=0) > 1e-3 * np.abs(beside).max()
    return {str(j): _short(effect["tau"][:, j]) for j in np.flatnonzero(apart)}


def _moved(log: Mapping[str, Any], role: str) -> dict[str, Any]:
    """A motion of the player: postures and, for each joint, |residual| relative to its maximum, 0 to 1."""
    residual = np.abs(log["tau"] - log[role])
    t = log["t"] - log["t"][0]
    grid = np.linspace(0.0, t[-1], max(2, int(t[-1] * FRAMES_PER_SECOND)))
    most = residual.max(axis=0)
    heat = residual / np.where(most > 0, most, 1.0)
    q, hot = (np.stack([np.interp(grid, t, x) for x in values.T], axis=1) for values in (log["q"], heat))
    return {
        "name": log["log"], "kind": "recording", "t": np.round(grid, 3), "q": np.round(q, 4), "trail": [],
        "heat": np.round(hot, 2),
    }  # fmt: skip


def _worst(logs: Sequence[Mapping[str, Any]], role: str) -> int:
    """The joint with the largest residual relative to its torque."""
    log = logs[0]
    residual = np.sqrt(np.mean(np.square(log["tau"] - log[role]), axis=0))
    return int(np.argmax(residual / (np.std(log["tau"], axis=0) + 1e-12)))


def _short(values: np.ndarray) -> list[Any]:
    """Five significant digits: far below a pixel, and a third of the size."""
    flat = [float(f"{x:.5g}") for x in values.ravel()]
    return np.reshape(flat, values.shape).tolist()
