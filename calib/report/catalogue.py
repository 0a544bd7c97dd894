"""docs/effects.md, generated from the catalogue: each effect's law, how it looks in a log, its parameters, and a picture.

`python -m calib.report.catalogue docs` writes the page and one SVG per effect. The picture is what a report shows if the effect is missing
from the model: measured minus predicted torque over time, speed, position and load.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np

from calib.report.figure import LINE, ROLES, draw_line, mosaic, name, svg
from calib.terminal.quantity import printed_unit
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import EFFECTS, Effect, with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

ARM, JOINT = "ur10e", "shoulder_lift_joint"
# Where gravity's torque never changes sign, a dead zone is never crossed.
ELSEWHERE = {"backlash": "shoulder_pan_joint"}
SECONDS, RATE = 24.0, 250.0
# Visible values, for effects whose starting values in the catalogue vanish on this motion or have the other sign.
SHOWN: dict[str, dict[str, float]] = {
    "payload": {"mass": 3.0, "com_x": 0.0, "com_y": 0.05, "com_z": 0.08},
    "link_inertia": {"mass": 12.0, "com_x": 0.05, "com_y": 0.0, "com_z": 0.1},
    "external_contact": {"start": 9.0, "duration": 3.0, "force_x": 0.0, "force_y": 0.0, "force_z": 25.0},
    "tool_force": {"force_x": 0.0, "force_y": 0.0, "force_z": 15.0},
    "base_tilt": {"roll": 0.03, "pitch": 0.05},
    "torque_saturation": {"limit": 120.0},
    "torque_gain": {"gain": 1.1},
    "joint_elasticity": {"stiffness": 8000.0},
    "torque_ripple": {"amplitude": 1.5, "cycles": 12.0, "phase": 0.0},
    "thermal_friction": {"relative_drop": 0.4, "time_constant": 8.0},
}
_INK = (
    "".join(f".stroke-{role}{{stroke:{colour}}}.fill-{role}{{fill:{colour}}}" for role, colour in ROLES.items())
    + "@media(prefers-color-scheme:dark){.stroke-ink{stroke:#e8eaed}.fill-ink{fill:#e8eaed}.stroke-muted{stroke:#a3acb6}.fill-muted{fill:#a3acb6}.stroke-grid{stroke:#363d46}.stroke-before{stroke:#ff9a57}.fill-before{fill:#ff9a57}}text{font-family:sans-serif}"
)


def write(docs: Path) -> None:
    """Write effects.md and effects/<name>.svg into `docs`."""
    (docs / "effects").mkdir(parents=True, exist_ok=True)
    for effect in EFFECTS:
        (docs / "effects" / f"{effect.name}.svg").write_text(picture(effect), encoding="utf-8")
    (docs / "effects.md").write_text(page(), encoding="utf-8")


def page() -> str:
    """The Markdown page."""
    lines = [
        "# The effects, how each looks, and how it is distinguished",
        "",
        "This page is generated from `sim/effects/` by `make docs`; `calib effects NAME` prints the same on the terminal.",
        "",
        f"Each picture shows the torque residual of one joint ({JOINT.replace('_joint', '').replace('_', ' ')} of a {ARM}) when the",
        "arm has the effect and the model does not: over time, speed, position and load, as in a report. These are clean",
        "computations without noise; in a real log the same shape is under the noise band.",
        "",
        "| effect | of | what it is |",
        "|---|---|---|",
        *(
            f"| [`{e.name}`](#{e.name}) | {'a joint' if e.scope == 'joint' else 'the whole arm'} | {e.summary} |"
            for e in EFFECTS
        ),
        "",
    ]
    for effect in EFFECTS:
        others = "; ".join(dict.fromkeys(f"`{law.law}`" for law in effect.forms()))
        lines += [
            f"## {effect.name}",
            "",
            f"{effect.summary[0].upper()}{effect.summary[1:]}: `{effect.law}`",
            "",
            f"![Residual of a model without {effect.name}](effects/{effect.name}.svg)",
            "",
            f"- **Looks like** {effect.looks}.",
            *([f"- **Distinguished by** {effect.experiment}."] if effect.experiment else []),
            *([f"- **Other published laws**, which its standard deviations allow for: {others}."] if others else []),
            f"- **Reference** {effect.reference}.",
            "",
            "| parameter | unit | meaning |",
            "|---|---|---|",
            *(f"| `{p.name}` | {printed_unit(p.unit) or '1'} | {p.meaning} |" for p in effect.parameters),
            "",
        ]
    return "\n".join(lines)


def picture(effect: Effect) -> str:
    """The residual that the effect leaves at one joint, as a stand-alone SVG that follows light and dark mode."""
    arm, motion = load_arm(ARM), _motion()
    joint = ELSEWHERE.get(effect.name, JOINT)
    j = arm.joint_index(joint)
    instance = ArmEffect(effect.name, joint if effect.scope == "joint" else None, _values(effect))
    quiet = predict(arm, motion)
    left = predict(with_effect(arm, _on_top(arm, instance)), motion)[:, j] - quiet[:, j]
    figure, panel = mosaic(
        [["time", "speed", "position", "load"]], width=9.6, height=1.7, sharey=True, width_ratios=[1.4, 1, 1, 1]
    )
    draw_line(panel["time"], motion.t, left, 200, **(LINE["before"] | {"linestyle": "-"}))
    for key, x in (("speed", motion.dq[:, j]), ("position", motion.q[:, j]), ("load", quiet[:, j])):
        panel[key].plot(x[::50], left[::50], ".", color=ROLES["before"], markersize=2.0)
    for key, label in (("time", "t [s]"), ("speed", "speed [rad/s]"), ("position", "position [rad]"), ("load", "load [N m]")):
        name(panel[key], x=label)
        panel[key].axhline(0, color=ROLES["muted"], linewidth=0.6)
    panel["time"].set_ylabel("residual [N m]")
    if not np.max(np.abs(left)) > 1e-3:
        raise ValueError(f"{effect.name} leaves no visible residual with {instance.parameters}; give it values in SHOWN")
    text = str(svg(figure, f"What a model without {effect.name} leaves"))
    text = re.sub(r'\b(id="|href="#|url\(#|aria-labelledby=")f\d+-', r"\1", text)
    return text.replace(">", f"><style>{_INK}</style>", 1) + "\n"


def _values(effect: Effect) -> dict[str, float]:
    return SHOWN.get(effect.name) or {p.name: p.grid[0] for p in effect.parameters}


def _on_top(arm: Arm, instance: ArmEffect) -> ArmEffect:
    """The effect to add: one that the nominal arm already has (friction, reflected inertia) is raised by a third, so that a difference shows."""
    own = arm.effect(instance.effect, instance.joint)
    if own is None:
        return instance
    return ArmEffect(instance.effect, instance.joint, {key: 1.33 * value for key, value in own.parameters.items()})


def _motion() -> Trajectory:
    """Two sines per joint without pauses, a wide slow one and a small fast one, so that no two variables are correlated."""
    t = np.arange(0, SECONDS, 1 / RATE)
    home = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
    q, dq, ddq = np.tile(home, (len(t), 1)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
    for j in range(6):
        for k, (size, rate) in enumerate(((0.7, 0.55 + 0.11 * j), (0.12, 2.1 + 0.37 * j))):
            phase = 1.3 * j + 0.7 * k
            q[:, j] += size * np.sin(rate * t + phase)
            dq[:, j] += size * rate * np.cos(rate * t + phase)
            ddq[:, j] -= size * rate**2 * np.sin(rate * t + phase)
    return Trajectory(t, q, dq, ddq)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
