"""`calib export ARM`: the arm for other tools."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from calib.run_folder import conclude, new_run
from calib.terminal import console, options
from sim.errors import ConfigError

UNSTATED_SPEED = 1.0  # rad/s or m/s up to which the friction of a joint without a speed limit is looked at


def _formats(incomplete: str) -> list[str]:
    from sim.export import FORMATS

    return [name for name in FORMATS if name.startswith(incomplete)]


def command(
    arm: Annotated[
        str,
        typer.Argument(
            metavar="ARM",
            help="Name from configs/arms, arm folder, .xml/.urdf file, or `latest` for the newest calibrated arm.",
            autocompletion=options.calibrated_names,
        ),
    ],
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="mjcf, urdf, isaaclab, feedforward or table; may be repeated. All if not given.",
            autocompletion=_formats,
        ),
    ] = None,
    out: options.Out = None,
    json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Write an arm, nominal or calibrated, for MuJoCo, ROS, Isaac Lab and controllers, and as a table of parameters.

    MuJoCo and Pinocchio compute the same rigid-body torques from each model as calib. The MuJoCo model has the effects: most as native
    elements, some through `import calib.mujoco`, and those of sensors in its `read`. The command lists which, and what is left out.
    URDF holds friction and reflected inertia; the table holds everything.

    Example:

        calib export runs/real/arm --out exported
    """
    import numpy as np

    from calib.newest_arm import named
    from sim.arm import load_arm
    from sim.export import FORMATS, export
    from sim.mujoco_export import exported_model
    from sim.passivity import driving_friction
    from sim.urdf import not_in_urdf, urdf_text

    arm = named(arm)
    table = load_arm(arm, configs)
    left_out = ""
    formats = tuple(only or FORMATS)
    if not only:
        try:
            urdf_text(table)
        except ConfigError as error:
            formats = tuple(name for name in FORMATS if name != "urdf")
            left_out = f"no URDF: {error}"
    fastest = np.where(np.isfinite(table.dq_max), table.dq_max, UNSTATED_SPEED)
    driven = [found.joint for found in driving_friction(table, fastest, np.zeros(table.n))]
    stand_ins = table.prior.numbers == "unknown"
    folder = new_run(table, "export", out)
    files = export(table, folder, formats)
    model = exported_model(table) if "mjcf" in formats else None
    effects = [] if model is None else model.table["effects"]
    removed = [] if model is None else model.removed
    outside = [e.title for e in not_in_urdf(table)] if "urdf" in formats else []
    outcome = f"{arm} is written as {len(files)} file{'s' * (len(files) != 1)}"
    conclude(outcome)
    if json:
        shown = [{key: row[key] for key in ("effect", "joint", "form", "how", "error")} for row in effects]
        console.print_json(
            {
                "arm": table.name,
                "files": files,
                "effects": shown,
                "left_out": left_out or None,
                "removed_from_mjcf": removed,
                "not_in_urdf": outside,
                "driven_by_friction": driven,
                "masses_unknown": stand_ins,
            }
        )
        return
    console.table(["file", "bytes"], [[str(file), file.stat().st_size] for file in files])
    if effects:
        console.table(["in the MuJoCo model", "of", "form", "as", "but"], _by_form(effects, table.joint_names))
        for form, sentence in SAID.items():
            if any(row["form"] == form for row in effects):
                console.say(sentence)
    if left_out:
        console.warn(left_out)
    if stand_ins:
        console.warn(
            f"the masses of {arm} are unknown: the files hold stand-ins with which no simulation is true; identify them first with "
            f"`calib identify {arm} LOG...` and export the arm that it writes"
        )
    if removed:
        console.warn(f"the MuJoCo model leaves out what the arm does not have: {'; '.join(removed)}")
    if outside:
        console.warn(f"the URDF leaves out what its format cannot hold: {'; '.join(outside)}")
    if driven:
        console.warn(
            f"friction drives {', '.join(driven)} within the speed limits of {arm} (up to {UNSTATED_SPEED:g} rad/s or m/s where none is stated), which is impossible for a passive joint: a simulation can diverge. "
            "The torque reading excludes what the controller adds, or a law is used beyond the speeds of its recordings"
        )
    console.say(f"{outcome} in {folder}.")


SAID = {
    "callback": 'callback: plain MuJoCo leaves it out; `import calib.mujoco` and `calib.mujoco.load("FILE.xml")` simulate it.',
    "sensor": "sensor: the motion is the true one; `calib.mujoco.read(model, data)` returns what encoders and drives report.",
}


def _by_form(effects: list[dict[str, Any]], joints: Sequence[str]) -> list[list[Any]]:
    """One row for each effect and form, with the joints that have it; the bodies first."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for row in effects:
        key = (row["effect"], row["form"], row["how"], row["error"])
        rows.setdefault(key, []).append(row["joint"] or "the arm")
    listed = [
        [effect, "all joints" if owners == list(joints) else ", ".join(owners), form, how, error]
        for (effect, form, how, error), owners in rows.items()
    ]
    return [["masses, gravity, frames", "the arm", "native", "body, inertial, option", ""], *listed]
