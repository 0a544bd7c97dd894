"""`calib diagnose`: which physical effect is missing from the model?"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.run_folder import conclude, new_run, require_free
from calib.terminal import console, options
from sim.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

LIST_OPTIONS = ("--holdout", "--baseline")


def command(
    arm: options.ArmOrLogArgument,
    log: options.LogsArgument = None,
    holdout: Annotated[
        list[Path] | None, typer.Option(metavar="LOG", help="Recordings of another motion, held out to show the residual.")
    ] = None,
    baseline: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG", help="Three or more recordings of the same arm when it was healthy: identify what has changed since."
        ),
    ] = None,
    accept_partial: options.AcceptPartial = False,
    assume: options.Assume = None,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> int:
    """Compare an arm's model with recordings and identify the physical effects that it is missing.

    Writes diagnosis.json, report.html and the corrected arm folder arm/. Exit code 0: no effect is missing. 1: one is
    found, something stays unexplained, or the model does not agree with the recordings. 2: the data cannot be used.

    Example:

        calib diagnose ur10e friction.mcap excitation.mcap --holdout validation.mcap
    """
    from calib.claims.diagnosis_sentences import quantity
    from calib.diagnosis.changes import diagnose_changes, require_baseline
    from calib.diagnosis.whole import diagnose_pieces
    from calib.newest_arm import named
    from calib.terminal.recordings import arm_and_logs, read_logs, read_pieces, require_unseen
    from logs import is_log
    from sim.arm import load_arm
    from sim.required import require_identified
    from sim.units import headed

    arm = named(arm)
    subject, given = arm_and_logs(arm, log, configs)
    require_identified(subject, "a diagnosis would find their error and nothing else")
    require_unseen([*given, *(baseline or [])], holdout or [])
    require_free(out)
    with console.progress("diagnose") as advance, tempfile.TemporaryDirectory(prefix="calib-") as scratch:
        logs = read_pieces(given, subject, Path(scratch), accept_partial, assume)
        apart = read_logs(holdout or [], subject, accept_partial, assume)
        healthy = read_logs(baseline or [], subject, accept_partial, assume)
        if baseline:
            require_baseline(len(healthy))
        folder = new_run(subject, "diagnose", out)
        if baseline:
            found = diagnose_changes(subject, list(logs), apart, healthy, progress=lambda text: advance(0, text))
        else:
            found = diagnose_pieces(subject, logs, apart, progress=lambda text: advance(0, text))[0].without_fits()
        found.write(folder, subject)
        answer = found.answer
        from calib import evidence  # imported here: it loads the plotting libraries, after the fits have freed their memory
        from calib.report import diagnosis as page
        from calib.report.evidence import gap_columns, gap_title

        advance(0, "comparing before and after")
        shown = evidence.of_diagnosis(
            subject,
            load_arm(str(folder / "arm")) if answer["arm_out"] else subject,
            apart[0] if apart else logs[len(logs) - 1],
            found,
            apart[1:],
        )
        page.write(folder / "report.html", found.answer, shown, subject)
    conclude(page.sentence(answer))
    code = exit_code(answer)
    if as_json:
        console.print_json(answer)
        return code
    rows = [
        [e["effect"], e["joint"] or "whole arm", name, quantity(p), quantity({"value": p["nominal"], "unit": p["unit"]})
         if p["nominal"] is not None else None, f"{e['confidence']:.0%}"]
        for e in answer["effects"]
        for name, p in e["parameters"].items()
    ]  # fmt: skip
    if rows:
        console.table(["effect", "joint", "parameter", "value", "nominal", "confidence"], rows, "identified effects")
    gap = answer["gap"]
    if gap["before"]:
        noise = gap["noise_floor"] or ["not measured"] * len(gap["joints"])
        columns = gap_columns(gap) | {"noise floor": noise}
        console.table(
            ["joint", *columns],
            [list(row) for row in zip(gap["joints"], *columns.values(), strict=True)],
            *headed([gap_title(answer)], subject.tree.prismatic),
        )
    for check in answer["data_checks"]:
        if not check["ok"]:
            console.say(f"{check['check']}: {check['detail']}")
    console.conclusion(page.sentence(answer), page.next_steps(answer, folder))
    changed = found.correction is not None
    console.say(f"{folder}: diagnosis.json, {'arm/, ' if answer['arm_out'] and changed else ''}report.html")
    name = subject.name if is_log(arm) else arm
    if not changed and answer["verdict"] != "bad_data":
        console.say(
            f"Nothing is added to {name} or changed in it, so {'arm/ there is a copy of it' if answer['arm_out'] else 'no arm is written'}."
        )
    read = options.read_as(accept_partial, assume, configs)
    recordings: list[str | Path] = [arm, *(log or []), *options.held_out(holdout), *read]
    if then := following(answer, changed, folder, name, recordings, read):
        console.next_step(then)
    return code


def following(
    answer: Mapping[str, Any], changed: bool, folder: Path, arm: str, recordings: list[str | Path], read: list[str | Path]
) -> list[str | Path]:
    """The command to type next; empty for recordings that cannot be used."""
    from calib.claims.of_diagnosis import disagrees, is_corrected
    from calib.report.diagnosis import noise_unknown, refit

    if answer["verdict"] == "bad_data":
        return []
    if any(e.get("indistinguishable_from") for e in answer["effects"]):
        return ["plan", arm, "--cell", "CELL", "--discriminate", folder]
    if changed and (is_corrected(answer) or answer["verdict"] == "no_missing_effect"):
        return ["validate", folder / "arm", "OTHER_RECORDING", *read]
    if answer["effects"] or disagrees(answer) or answer["verdict"] == "unexplained":
        return ["record", "CELL", "latest"]
    if refit(answer):
        return ["identify", *recordings]
    if noise_unknown(answer):
        return ["plan", arm, "--cell", "CELL"]
    return ["export", _fitted(str(answer["arm"])) or arm]


def _fitted(name: str) -> Path | None:
    """The arm folder of the newest `calib identify`, if it is of the arm `name`."""
    from calib.past_runs import latest

    try:
        run = latest("identify")
    except ConfigError:
        return None
    return run.folder / "arm" if run.arm == name and (run.folder / "arm").is_dir() else None


def exit_code(answer: Mapping[str, Any]) -> int:
    """0: no effect is missing; 1: one is, something stays unexplained, or the model does not agree; 2: the data cannot be used."""
    from calib.claims.of_diagnosis import disagrees

    return 1 if disagrees(answer) else {"no_missing_effect": 0, "bad_data": 2}.get(answer["verdict"], 1)
