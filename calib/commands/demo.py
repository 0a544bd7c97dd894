"""`calib demo`: the whole story on the mock arm, with an effect hidden from the tool."""

from __future__ import annotations

import secrets
import shlex
import sys
import time
from contextlib import redirect_stdout
from typing import Annotated

import typer

from calib import console
from calib.run_folder import new_run


def command(
    seed: Annotated[int | None, typer.Option(min=0, help="Draw this effect and this noise again; random if not given.")] = None,
    out: console.Out = None,
    as_json: console.Json = False,
) -> None:
    """Tell the whole story on the mock arm: an effect is hidden, the arm is planned for, checked, recorded, identified, diagnosed.

    At the end it says what was hidden; the last line is the path of the report.

    Example:

        calib demo --seed 3
    """
    from calib import demo
    from calib.main import COMMANDS, main
    from sim.arm import load_arm
    from sim.cell import load_cell

    began = time.monotonic()
    seed = secrets.randbelow(10_000) if seed is None else seed
    cell = load_cell("mock-ur10e")
    arm = load_arm(cell.table.arm)
    hidden = demo.hide(arm, seed)
    folder = new_run(arm, "demo", out, cell, seed=seed)
    place = folder / "demo-cell.toml"
    demo.write_cell(place, cell, hidden, seed)
    steps = [step for step in demo.story(arm.name, place, folder) if step.arguments[0] in COMMANDS]
    with redirect_stdout(sys.stderr if as_json else sys.stdout):
        console.say(f"Something is hidden in a simulated {arm.name} (seed {seed}); the tool is told nothing of it.")
        for number, step in enumerate(steps, 1):
            console.say(f"\n{number} of {len(steps)}. {step.why}\n$ calib {shlex.join(step.arguments)}")
            code = main(list(step.arguments))
            if code not in step.fine:
                raise typer.Exit(code)
    found = demo.named(folder)
    report = next(page for page in (folder / "diagnosis" / "report.html", folder / "fit" / "report.html") if page.is_file())
    right = {(effect, joint) for effect, joint, _ in found} == {(hidden.effect, hidden.joint)}
    if as_json:
        names = [{"effect": effect, "joint": joint, "parameters": values} for effect, joint, values in found]
        seconds = time.monotonic() - began
        console.print_json(
            {
                "schema": "demo/1",
                "seed": seed,
                "hidden": hidden,
                "found": names,
                "right": right,
                "seconds": seconds,
                "report": report,
            }
        )
        return
    console.say("\nWhat was hidden, and what was found:")
    rows = [["hidden", hidden.effect, hidden.joint or "whole arm", _values(hidden.parameters)]]
    rows += [["found", effect, joint or "whole arm", _values(values)] for effect, joint, values in found]
    console.table(["", "effect", "joint", "values"], rows)
    if found:
        console.say(
            "The name is right." if right else "The name is not the one that was hidden; the report says what speaks for it."
        )
    console.say(f"It took {time.monotonic() - began:.0f} s. To see it again: calib demo --seed {seed}")
    console.say(str(report))


def _values(parameters: dict[str, float]) -> str:
    return ", ".join(f"{key} {value:.4g}" for key, value in parameters.items())
