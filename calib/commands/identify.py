"""`calib identify`: a calibrated arm folder and a result with uncertainties from logs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from calib.run_folder import conclude, new_run, require_free
from calib.terminal import console, options

LIST_OPTIONS = ("--holdout", "--loaded")


def command(
    arm: options.ArmOrLogArgument,
    log: options.LogsArgument = None,
    holdout: Annotated[
        list[Path] | None, typer.Option("--holdout", metavar="LOG", help="Recordings the fit never sees, one or several.")
    ] = None,
    loaded: Annotated[
        list[Path] | None, typer.Option("--loaded", metavar="LOG", help="Recordings with a load at the flange, one or several.")
    ] = None,
    known_mass: Annotated[
        float | None,
        typer.Option(
            "--known-mass",
            min=0.001,
            max=10_000.0,
            help="kg of that load, or of the load of a drive on a bench; the torque constants are estimated from it.",
        ),
    ] = None,
    cutoff: Annotated[
        float | None, typer.Option(min=0.1, max=1000.0, help="Cutoff of the filter, Hz; from the motion if not given.")
    ] = None,
    masses_only: Annotated[bool, typer.Option("--masses-only", help="Fit masses and centres of mass, keep inertias.")] = False,
    no_robust: Annotated[bool, typer.Option("--no-robust", help="Give every row full weight.")] = False,
    accept_partial: options.AcceptPartial = False,
    assume: options.Assume = None,
    max_error: options.MaxError = None,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> int:
    """Identify friction, base parameters and physically consistent inertias of an arm from recordings of it.

    Writes arm/ (the calibrated arm folder), result.json and report.html. Exit code 0: the fit is good on the held-out logs (on
    the training logs if none is held out), that is, at every joint the residual RMS is at most 20 % of the torque's standard deviation or
    1 % of the joint's maximum torque. 1: it is poor. 2: at half of the joints or more the residual exceeds both the torque's standard
    deviation and 1 % of the maximum torque, a joint hardly moves, or the recordings are not of this arm.

    Example:

        calib identify ur10e friction.mcap excitation.mcap --holdout validation.mcap --out runs/first

        calib identify ur10e excitation.mcap --loaded with-weight.mcap --known-mass 5
    """
    from calib.identification.base_fit import Options
    from calib.identification.calibrated import write_calibrated
    from calib.identification.identify import identify
    from calib.identification.loaded import identify_with_load, identify_with_own_load
    from calib.identification.outcome import evidence, gap_table, parameter_table
    from calib.newest_arm import named
    from calib.report import identification as page
    from calib.terminal.recordings import arm_and_logs, read_logs, read_pieces, require_unseen
    from calib.verdict import Verdict
    from sim.units import headed

    arm = named(arm)
    nominal, given = arm_and_logs(arm, log, configs)
    require_unseen(given, holdout or [])
    require_free(out)
    with console.progress("identify") as advance, tempfile.TemporaryDirectory(prefix="calib-") as scratch:
        logs = read_pieces(given, nominal, Path(scratch), accept_partial, assume)
        held = read_logs(holdout or [], nominal, accept_partial, assume)
        carrying = read_logs(loaded or [], nominal, accept_partial, assume)
        folder = new_run(nominal, "identify", out)
        chosen = Options(cutoff=cutoff, robust=not no_robust, masses_only=masses_only, max_error=max_error)

        def show(stage: str, share: float) -> None:
            advance(0, f"{stage} {share:.0%}" if share else stage)

        if loaded:
            found, _ = identify_with_load(nominal, logs, carrying, held, chosen, known_mass, show)
        elif known_mass is not None:
            found = identify_with_own_load(nominal, logs, held, chosen, known_mass, show)
        else:
            found = identify(nominal, logs, held, chosen, show)
        write_calibrated(folder / "arm", nominal, found.arm)
        found.known.write(folder / "arm", found.model)
        found.result.write(folder / "result.json")
        page.write(folder / "report.html", found.result.as_dict(), evidence(found), nominal)
    result = found.result
    conclude(result.outcome)
    then: list[str | Path]
    if result.verdict is Verdict.GOOD:
        then = [
            "validate",
            folder / "arm",
            *(holdout or [Path("OTHER_RECORDING")]),
            *options.read_as(accept_partial, assume, configs),
        ]
    else:
        # only the identified arm has torque constants from a known mass, and masses that were unknown
        nobodys = known_mass is not None or nominal.prior.numbers == "unknown"
        then = ["diagnose", folder / "arm" if nobodys else arm, *(log or [])]
        then += ["--holdout", *holdout] if holdout else []
        then += options.read_as(accept_partial, assume, configs)
    if as_json:
        console.print_json({**result.as_dict(), "next": console.command_line(then)})
        return result.verdict.exit_code
    for gap, title in ((result.training, "training logs"), (result.holdout, "held-out logs")):
        if gap is not None:
            headers, rows = gap_table(result.joint_names, gap)
            console.table(
                headed(headers, nominal.tree.prismatic), rows, f"torque residual on the {title}: {', '.join(gap.logs)}"
            )
    headers, rows = parameter_table(result)
    console.table(headed(headers, nominal.tree.prismatic), rows, "friction and reflected inertia")
    first, *more = [claim.sentence for claim in result.claims if claim.sentence not in result.findings]
    console.conclusion(first, [*result.findings, *more])
    console.say(f"{folder}: arm/, result.json, report.html")
    console.next_step(then)
    return result.verdict.exit_code
