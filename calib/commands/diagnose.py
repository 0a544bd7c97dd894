"""`calib diagnose`: which physical effect does the model lack?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib import console
from calib.run_folder import new_run

LIST_OPTIONS = ("--holdout",)


def command(
    arm: console.ArmArgument,
    log: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Recordings: .mcap, rosbag2 folders, ur_rtde .csv.")],
    holdout: Annotated[
        list[Path] | None, typer.Option(help="Recordings of another motion, kept apart to show the gap.")
    ] = None,
    accept_partial: console.AcceptPartial = False,
    out: console.Out = None,
    as_json: console.Json = False,
    configs: console.Configs = None,
) -> None:
    """Compare an arm's model with recordings and name the physical effects that it lacks.

    Writes diagnosis.json and the corrected arm folder arm/.

    Example:

        calib diagnose ur10e friction.mcap excitation.mcap --holdout validation.mcap
    """
    from calib.diagnosis.diagnose import diagnose
    from calib.recordings import read_logs
    from sim.arm import load_arm

    subject = load_arm(arm, configs)
    folder = new_run(subject, "diagnose", out)
    with console.progress("diagnose") as advance:
        logs = read_logs(log, subject, accept_partial)
        apart = read_logs(holdout or [], subject, accept_partial) if holdout else []
        found = diagnose(subject, logs, apart, lambda text: advance(0, text))
        found.write(folder, subject)
    if as_json:
        console.print_json(found.answer)
        return
    rows = [
        [e["effect"], e["joint"] or "-", name, p["value"], p["std"], p["nominal"], p["unit"]]
        for e in found.answer["effects"]
        for name, p in e["parameters"].items()
    ]
    if rows:
        console.table(["effect", "joint", "parameter", "value", "std", "nominal", "unit"], rows, "missing effects")
    gap = found.answer["gap"]
    columns = zip(gap["joints"], gap["before"], gap["refit"], gap["after"], gap["noise_floor"], strict=True)
    console.table(
        ["joint", "before", "refit", "after", "noise floor"], [list(c) for c in columns], f"gap [N m] on {gap['log']}"
    )
    for item in found.answer["unexplained"]:
        console.say(f"{item['joint']}: {item['rms']:.3g} N m that no effect of the catalogue explains.")
    console.say(
        {"effects_found": "Effects found.", "no_missing_effect": "No missing effect."}.get(
            found.answer["verdict"], "Unexplained."
        )
    )
    console.say(f"{folder}: diagnosis.json, arm/")
