"""`calib demo`: all steps on the mock arm, with an effect hidden from the tool."""

from __future__ import annotations

import io
import json
import secrets
import shlex
import sys
import time
from contextlib import redirect_stdout
from typing import Annotated

import typer

from calib.run_folder import conclude, new_run
from calib.terminal import console, options


def command(
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=2**63 - 1, help="Seed of the effect and the noise, to repeat a demo; random if not given."),
    ] = None,
    out: options.Out = None,
    as_json: options.Json = False,
) -> None:
    """Demonstrate all steps on a simulated arm: an effect is hidden, and check, plan, record, identify, validate and
    diagnose search for it.

    At the end the hidden effect is revealed; the last line is the path of the report.

    Example:

        calib demo --seed 3
    """
    import numpy as np

    from calib import demo
    from calib.claims.diagnosis_sentences import words
    from calib.main import start
    from calib.report import tracking as page
    from calib.terminal.quantity import significant
    from sim.cell import load_arm_of, load_cell
    from sim.effects import effect_named

    began = time.monotonic()
    seed = secrets.randbelow(10_000) if seed is None else seed
    cell = load_cell("mock-ur10e")
    arm = load_arm_of(cell)
    hidden = demo.hide(arm, np.array(cell.table.home), seed)
    folder = new_run(arm, "demo", out, cell, seed=seed)
    place = folder / "demo-cell.toml"
    demo.write_cell(place, cell, hidden, seed)
    with redirect_stdout(sys.stderr if as_json else sys.stdout):
        console.say(
            f"Something is wrong with a simulated {arm.name}: an effect was drawn at random (seed {seed}) and hidden in it. The tool "
            "does not know it and searches for it with the same commands that you would use on a real arm."
        )
        steps = demo.story(arm.name, place, folder)
        for number, step in enumerate(steps, 1):
            console.say(f"\n{number} of {len(steps)}. {step.why}")
            console.copyable(f"   $ calib {shlex.join(step.arguments)}")
            printed, since = io.StringIO(), time.monotonic()
            with redirect_stdout(printed):
                code, sentence = start(list(step.arguments))
            (folder / f"{number}-{step.arguments[0]}.txt").write_text(printed.getvalue(), encoding="utf-8")
            if code not in step.fine:
                console.say(printed.getvalue())
                conclude(f"ended at step {number}, calib {step.arguments[0]}: {sentence}")
                raise typer.Exit(code)
            console.say(f"   {sentence[0].upper()}{sentence[1:]}. ({time.monotonic() - since:.0f} s)")
            if code and step.if_poor:
                console.say(f"   {step.if_poor}")
    report = folder / "diagnosis" / "report.html"
    found = json.loads((folder / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    revealed = demo.reveal(hidden, found)
    followed = demo.under_control(arm, hidden, folder, found)
    tracking = {name: t.as_dict() for name, t in followed.items()}
    (folder / "tracking.json").write_text(json.dumps({"schema": "tracking/1", **tracking}) + "\n", encoding="utf-8")
    what = words(hidden.effect, hidden.joint)
    shown = page.write(folder, arm.name, arm.joint_names, followed, what, revealed.rows)
    seconds = time.monotonic() - began
    conclude(f"seed {seed}, {hidden.effect} hidden: {revealed.sentence}")
    if as_json:
        console.print_json(
            {
                "schema": "demo/1", "seed": seed, "hidden": hidden, "found": found["effects"], "right": revealed.right,
                "tracking": tracking, "seconds": seconds, "report": report, "page": shown,
            }
        )  # fmt: skip
        return
    console.say(f"\nAnd this was hidden: {what} ({effect_named(hidden.effect).summary}).")
    console.table(["effect", "joint", "parameter", "hidden", "found"], revealed.rows)
    console.say(f"{revealed.sentence[0].upper()}{revealed.sentence[1:]}.")
    console.say("\nThe arm follows the validation motion under the torque of a model, with a weak feedback.")
    console.table(
        ["model in the controller", "tracking error RMS [mrad]", "largest of a joint [mrad]", "feedback torque RMS [N m]"],
        [
            [name, *(float(significant(x)) for x in (1e3 * t.rms, 1e3 * t.error.max(), float(np.sqrt(np.mean(t.feedback**2)))))]
            for name, t in followed.items()
        ],
    )
    console.say(f"{page.sentence(arm.joint_names, followed)}.")
    console.say(f"\nIt took {seconds:.0f} s; the output of each command is in {folder}")
    console.say(f"To repeat this demo: calib demo --seed {seed}")
    console.say("Tracking before and after, and the report, for a browser:")
    console.copyable(str(shown.resolve()))
    console.copyable(str(report.resolve()))
