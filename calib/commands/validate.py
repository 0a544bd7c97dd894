"""`calib validate`: predicted against measured, on logs that no fit has seen."""

from __future__ import annotations

import math
from typing import Annotated

import typer

from calib.run_folder import conclude, new_run, require_free
from calib.terminal import console, options
from calib.terminal.quantity import percentages, share


def command(
    arm: options.ArmOrLogArgument,
    log: options.LogsArgument = None,
    forward: Annotated[bool, typer.Option(help="Simulate the arm under the measured torque as well.")] = True,
    cutoff: Annotated[
        float | None, typer.Option(min=0.1, max=1000.0, help="Cutoff of the filter, Hz; from the motion if not given.")
    ] = None,
    accept_partial: options.AcceptPartial = False,
    assume: options.Assume = None,
    max_error: options.MaxError = None,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> int:
    """Compare what an arm predicts with what was measured: torque along the motion, and motion under the torque.

    Writes validation.json, report.html, prediction.csv (t, tau_<joint> measured, tau_hat_<joint> predicted) and prediction.mcap for
    Foxglove and Rerun: the moving arm, and its torque beside the predicted one. Exit code 0: the model is good, that is, at every joint compared the residual RMS is at most 20 % of the torque's standard deviation or 1 % of the joint's maximum torque. 1: it is
    poor. 2: wrong arm or wrong model (at half of the joints or more the residual exceeds both the torque's standard deviation and 1 % of the
    maximum torque), no joint moves, or the recordings are not of this arm.

    Example:

        calib validate runs/first/arm validation.mcap
    """
    from calib import evidence
    from calib.newest_arm import named
    from calib.report import validation as page
    from calib.terminal.diagnosis_of_fit import diagnosis_of_fit
    from calib.terminal.recordings import arm_and_logs, read_logs
    from calib.validation.forward import SHORT
    from calib.validation.prediction_log import write_predictions
    from calib.validation.validate import validate
    from calib.verdict import Verdict
    from logs import is_log
    from sim.required import require_identified
    from sim.units import headed

    arm = named(arm)
    subject, given = arm_and_logs(arm, log, configs)
    require_identified(subject, "a validation would compare recordings with stand-ins")
    require_free(out)
    with console.progress("validate") as advance:
        logs = read_logs(given, subject, accept_partial, assume)
        folder = new_run(subject, "validate", out)
        found = validate(subject, logs, forward, cutoff, lambda stage, share: advance(0, f"{stage} {share:.0%}"), max_error)
        found.write(folder)
        write_predictions(folder, subject, logs, found.checks)
        page.write(folder / "report.html", found.as_dict(), [evidence.of_check(check) for check in found.checks], subject)
    conclude(found.outcome)
    verdict = found.assessment.verdict
    name = subject.name if is_log(arm) else arm
    then = diagnosis_of_fit(arm)
    if then is None:
        diagnosis = ["diagnose", arm, *(log or []), *options.read_as(accept_partial, assume, configs)]
        then = ["export", name] if verdict is Verdict.GOOD else diagnosis
    if verdict is Verdict.NOTHING or (verdict is Verdict.GOOD and found.assessment.uncompared):
        then = ["plan", name]
    if as_json:
        console.print_json({**found.as_dict(), "next": console.command_line(then)})
        return verdict.exit_code
    constant = subject.torque_constant
    for check in found.checks:
        headers = ["joint", "residual [N m]", "sliding [N m]", "torque std [N m]", "residual share"]
        headers += [] if constant is None else ["residual [A]"]
        headers += [] if check.short is None else [f"error after {SHORT.seconds:g} s [mrad]", "bound [mrad]", "travel [mrad]"]
        headers = headed(headers, subject.tree.prismatic)
        rows = []
        for j, joint in enumerate(subject.joint_names):
            left = check.sliding[j] / check.signal[j] if check.signal[j] > 0 else float("nan")
            row = [joint, float(check.residual[j]), float(check.sliding[j]), float(check.signal[j]), share(left)]
            row += [] if constant is None else [float(check.residual[j] / constant[j])]
            if check.short is not None:
                bound = float("nan") if check.bound is None else check.bound[j]
                row += [_thousandths(check.short.angle[j]), 1e3 * float(bound), 1e3 * float(check.short.travel[j])]
            rows.append(row)
        console.table(headers, rows, check.log)
        moved = [e for e in check.motion if e.starts]
        if moved:
            console.table(
                ["simulated motion", "windows", "flange RMS [mm]", *[f"{j} [mrad]" for j in subject.joint_names]],
                [[e.horizon.words, len(e.starts), *[_thousandths(x) for x in (e.flange, *e.angle)]] for e in moved],
                f"{check.log}: motion simulated under the measured torque",
            )
    joints = zip(subject.joint_names, found.assessment.left, found.assessment.limit, found.assessment.verdicts, strict=True)
    console.table(
        ["joint", "residual share", "limit", "verdict"],
        [[j, *((None, share(limit)) if math.isnan(x) else percentages(x, limit)), v.value] for j, x, limit, v in joints],
        "verdict",
    )
    first, *more = [claim.sentence for claim in found.claims]
    console.conclusion(first, more)
    console.say(f"{folder}: validation.json, prediction.csv, prediction.mcap, report.html")
    console.next_step(then)
    return verdict.exit_code


def _thousandths(error: float) -> float | str:
    """In mm or mrad; "unstable" if it is not finite."""
    return 1e3 * float(error) if math.isfinite(error) else "unstable"
