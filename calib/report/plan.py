"""plan.html: what the arm is about to do, in 3D and as curves against its limits, before anything moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from calib.report.along_motion import PLACES, Distances, Looks, looks_along
from calib.report.figure import ROLES, draw_line, mosaic, name, svg
from calib.report.page import Page, asset, template
from calib.report.scene import scene
from sim.arm import Arm
from sim.cell import Cell
from sim.trajectory import Trajectory

PARAMETERS = {
    "Ia": "reflected inertia", "coulomb": "Coulomb friction", "viscous": "viscous friction", "offset": "torque offset",
}  # fmt: skip
JOINT_COLOURS = [ROLES[r] for r in ("after", "before", "good", "refit", "accent", "ink")]


class NamedMotion(Protocol):
    """A named motion, as `safety.plan.Motion` is."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def trajectory(self) -> Trajectory: ...


def write(
    path: str | Path, arm: Arm, cell: Cell | None, motions: Sequence[NamedMotion], clearance: Distances | None = None,
    worth: Mapping[str, Any] | None = None,
) -> Path:  # fmt: skip
    """Write the preview of a plan; returns its path.

    clearance  distances in the cell; without them no clearance is drawn, which the page states
    worth      what the plan achieves: `condition` number; `identified` and `not_identified`, names of parameters, whose first term ends in
               the joint's number from 1; `notes`, sentences; every key is optional
    """
    worth = worth or {}
    looks = {motion.name: looks_along(arm, motion.trajectory, clearance) for motion in motions}
    total = sum(motion.trajectory.duration for motion in motions)
    page = Page(arm.name, _sentence(arm, cell, motions, looks, total), None, _facts(looks, total, worth), "plan")
    options = Markup("").join(
        Markup('<option value="{0}">{0} · {1:.0f} s</option>').format(m.name, m.trajectory.duration) for m in motions
    )
    page.embed(
        Markup(template("player.html").render(options=options)),
        asset("player.js"), asset("player.css"), {"scene": scene(arm, cell) | {"motions": [_played(m, looks[m.name]) for m in motions]}},
    )  # fmt: skip
    page.section("The motion against its limits")
    for motion in motions:
        look = looks[motion.name]
        body = Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(
            _curves(arm, cell, motion, look), _caption(motion)
        )
        page.embed(Markup('<div data-motion="{}">{}</div>').format(motion.name, body))
    _motions(page, motions, looks)
    _worth(page, arm, worth)
    return page.write(path)


def _played(motion: NamedMotion, look: Looks) -> dict[str, Any]:
    thin = max(1, len(look.t) // 600)
    return {
        "name": motion.name, "kind": motion.kind, "t": np.round(look.t, 3), "q": np.round(look.q, 4),
        "trail": np.round(look.flange[::thin], 3),
        "near": [
            {"to": place, "at": n.least.t, "distance": np.round(n.distance, 5), "pair": n.least.pair} for place, n in look.near.items()
        ],
    }  # fmt: skip


def _curves(arm: Arm, cell: Cell | None, motion: NamedMotion, look: Looks) -> Markup:
    rows = ["position", "speed", "acceleration", "flange", *look.near]
    figure, panel = mosaic([[row] for row in rows], height=1.45, sharex=True)
    t = motion.trajectory.t - motion.trajectory.t[0]
    middle, half = (arm.q_max + arm.q_min) / 2, (arm.q_max - arm.q_min) / 2
    shares = {
        "position": (motion.trajectory.q - middle) / half,
        "speed": motion.trajectory.dq / arm.dq_max,
        "acceleration": motion.trajectory.ddq / arm.ddq_max,
    }
    for key, share in shares.items():
        for j, joint in enumerate(arm.joint_names):
            style = {"color": JOINT_COLOURS[j % len(JOINT_COLOURS)], "linestyle": "-" if j < len(JOINT_COLOURS) else "--"}
            draw_line(panel[key], t, 100 * share[:, j], 300, linewidth=1.1, label=joint, **style)
        name(panel[key], f"{key}, share of its limit", y="%")
        _limits(panel[key], 100, both=True)
    draw_line(panel["flange"], look.t, look.speed, 300, color=ROLES["ink"], linewidth=1.1)
    name(panel["flange"], "speed of the flange", y="m/s")
    if cell is not None:
        _limits(panel["flange"], cell.table.motion.point_speed_max, both=False)
    for place, near in look.near.items():
        draw_line(panel[place], look.t, 1000 * near.spare, 300, color=ROLES["ink"], linewidth=1.1)
        name(panel[place], f"clearance to {place} beyond the margin; least {1000 * near.spare.min():.0f} mm", y="mm")
        panel[place].axvline(look.t[int(np.argmin(near.spare))], color=ROLES["bad"], linewidth=1.0, linestyle=(0, (4, 2)))
        _limits(panel[place], 0.0, both=False)
    panel[rows[-1]].set_xlabel("t [s]")
    panel[rows[-1]].set_xlim(0, t[-1])
    figure.legend(*panel["position"].get_legend_handles_labels(), loc="outside upper center", ncols=6, fontsize=8)
    return svg(figure, f"Motion {motion.name} against the limits of the arm", list(panel.values()))


def _limits(ax: Axes, limit: float, both: bool) -> None:
    for value in (limit, -limit) if both else (limit,):
        ax.axhline(value, color=ROLES["bad"], linewidth=0.9, linestyle=(0, (1, 2)))


def _sentence(arm: Arm, cell: Cell | None, motions: Sequence[NamedMotion], looks: Mapping[str, Looks], total: float) -> str:
    place = f" in {cell.name}" if cell is not None else ""
    fastest = max(float(look.speed.max()) for look in looks.values())
    text = f"{arm.name} will move for {_clock(total)}{place} in {len(motions)} motion{'s' * (len(motions) != 1)}, its flange at up to {fastest:.2f} m/s"
    for place in PLACES:
        near = [look.near[place] for look in looks.values() if place in look.near]
        if near:
            closest = min(near, key=lambda found: found.least.distance)
            text += f"; nearest to {place}: {closest.pair}, {1000 * closest.least.distance:.0f} mm"
    return text


def _facts(looks: Mapping[str, Looks], total: float, worth: Mapping[str, Any]) -> list[tuple[str, Any]]:
    facts: list[tuple[str, Any]] = [("duration", _clock(total))]
    facts.append(("fastest flange", f"{max(float(look.speed.max()) for look in looks.values()):.2f} m/s"))
    if worth.get("condition") is not None:
        facts.append(("condition number", f"{worth['condition']:.3g}"))
    if worth.get("identified") is not None:
        count = len(worth["identified"])
        facts.append(("identifies", f"{count} of {count + len(worth.get('not_identified', []))} parameters"))
    if not any(look.near for look in looks.values()):
        facts.append(("clearance", "not drawn: no cell was given"))
    return facts


def _caption(motion: NamedMotion) -> str:
    kind = "" if motion.kind == motion.name else f" ({motion.kind})"
    return f"{motion.name}{kind}: dotted red lines are limits; the vertical line is the moment that the player shows."


def _motions(page: Page, motions: Sequence[NamedMotion], looks: Mapping[str, Looks]) -> None:
    places = [place for place in PLACES if any(place in look.near for look in looks.values())]
    rows = []
    for motion in motions:
        look = looks[motion.name]
        row: list[Any] = [motion.name, motion.kind, motion.trajectory.duration, float(look.speed.max())]
        for place in places:
            near = look.near.get(place)
            row += [None, None, None] if near is None else [1000 * near.least.distance, near.pair, near.least.t]
        rows.append(row)
    headers = ["motion", "kind", "duration [s]", "flange [m/s]"]
    headers += [head for place in places for head in (f"closest to {place} [mm]", "between", "at [s]")]
    page.section("Motions").table(headers, rows)


def _worth(page: Page, arm: Arm, worth: Mapping[str, Any]) -> None:
    if not worth:
        return
    page.section("What the plan will and will not identify")
    page.items(list(worth.get("notes", [])))
    lists = [list(worth.get(key) or ()) for key in ("identified", "not_identified")]
    if not any(lists):
        return
    page.text(
        f"{len(lists[0])} of {sum(map(len, lists))} parameters improve over their nominal values; the others are held at "
        "nominal, because no motion of this plan excites them enough."
    )
    rows = [
        [joint, *(", ".join(_parameter_text(n) for n in names if _joint(n) == k) or None for names in lists)]
        for k, joint in enumerate(arm.joint_names, 1)
    ]
    page.table(
        ["joint", "improves", "held at nominal"],
        rows,
        "m: mass; mcx, mcy, mcz: mass times centre of mass; I: inertia about the joint's origin, of the link that the joint moves. "
        "*: only in a sum with others, which plan.toml states.",
    )  # fmt: skip


def _joint(parameter: str) -> int:
    """The joint of a parameter such as `mcx_2 - 0.6127 m_3`, counted from 1; 0 where its name has none."""
    number = parameter.split()[0].rpartition("_")[2]
    return int(number) if number.isdecimal() else 0


def _parameter_text(parameter: str) -> str:
    first, *others = parameter.split()
    return PARAMETERS.get(first.rpartition("_")[0], first.rpartition("_")[0]) + ("*" if others else "")


def _clock(seconds: float) -> str:
    minutes, left = divmod(round(seconds), 60)
    return f"{round(seconds)} s" if round(seconds) < 120 else f"{minutes} min {left} s"
