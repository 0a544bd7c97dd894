"""`calib plan`: motions that excite an arm's parameters, verified before they are written."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from calib.past_runs import LATEST, latest
from calib.run_folder import conclude, new_run
from calib.terminal import console, options


def command(
    arm: options.ArmArgument,
    cell: Annotated[
        str | None,
        typer.Option("--cell", help="Cell where the arm stands; without it, the mounting plane is the only obstacle."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The best of a few random motions, short sweeps, no probes.")] = False,
    period: Annotated[float, typer.Option(min=0.1, max=3600.0, help="Seconds of one period of the Fourier motions.")] = 20.0,
    periods: Annotated[
        int | None, typer.Option(min=1, max=100, help="Whole periods of the excitation; 2 if not given, 1 with --quick.")
    ] = None,
    harmonics: Annotated[int, typer.Option(min=3, max=12, help="Harmonics of the Fourier motions; 5 to 7 is usual.")] = 6,
    probes: Annotated[
        bool | None,
        typer.Option(
            "--probes/--no-probes",
            help="Reversal ladder, static holds, the same path at half speed; if not given, planned only without --quick.",
        ),
    ] = None,
    progressive: Annotated[
        bool, typer.Option("--progressive", help="First bring-up: unlock the joints one after another.")
    ] = False,
    home: Annotated[str | None, typer.Option(help="Posture where every motion begins and ends: rad, comma separated.")] = None,
    starts: Annotated[
        int | None,
        typer.Option(min=0, help="Starts of the optimiser, 0 keeps the best random motion; 8 if not given, 0 with --quick."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Seed of the random motions.")] = 0,
    discriminate: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Add a motion that separates the effects that this diagnosis could not distinguish."),
    ] = None,
    viewer: Annotated[
        bool, typer.Option("--viewer", help="Then show the motions in MuJoCo's viewer, if there is a display.")
    ] = False,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Plan friction sweeps, an informative excitation, a validation motion and probes for an arm.

    Writes a plan folder: plan.toml, one .npy per motion, plan.html to look at before anything moves.

    Example:

        calib plan ur10e --cell mock-ur10e --quick --out runs/plan
    """
    from calib.claims import Claim, in_one_sentence
    from calib.excitation.discriminate import ENOUGH, pairs_of
    from calib.excitation.home import open_cell, posture
    from calib.excitation.session import QUICK, Session, design
    from calib.report import plan as page
    from safety.collision import Clearance
    from safety.plan import require_arm_of, write_plan
    from safety.plausible import check_plausible
    from safety.stages import duration_of
    from sim.arm import load_arm
    from sim.cell import load_arm_of, load_cell, require_postures
    from sim.required import require_limits
    from sim.stated_facts import LIMIT_UNITS
    from sim.viewer import play, require_display

    if viewer:
        require_display()
    nominal = load_arm(arm, configs)
    where = load_cell(cell, configs) if cell else None
    stands = where or open_cell(nominal)
    if where:
        require_postures(where, nominal)
        require_arm_of(where, nominal, load_arm_of(where, configs))
    require_limits(nominal, *LIMIT_UNITS)
    check_plausible(nominal, stands)  # otherwise a long plan would be computed that no run accepts
    requested = replace(
        QUICK if quick else Session(), period=period, harmonics=harmonics, seed=seed, progressive=progressive,
        home=None if home is None else posture(home, nominal),
    )  # fmt: skip
    # options that are given override --quick
    requested = replace(
        requested,
        periods=requested.periods if periods is None else periods,
        probes=requested.probes if probes is None else probes,
        starts=requested.starts if starts is None else starts,
    )
    if discriminate is not None:
        if str(discriminate) == LATEST and not discriminate.exists():
            discriminate = latest("diagnose").folder
        requested = replace(requested, apart=tuple(pairs_of(discriminate, nominal)))
    folder = new_run(nominal, "plan", out, where)
    with console.progress("plan") as advance:
        designed = design(
            nominal, stands, requested, lambda stage, share: advance(0, f"{stage} {share:.0%}" if share else stage)
        )
        sealed = write_plan(folder / "sealed", nominal, designed.motions, where, designed.summary)
        for file in sorted(sealed.folder.iterdir()):
            shutil.move(file, folder / file.name)
        sealed.folder.rmdir()
        worth = {"condition": designed.worth.condition, "identified": designed.summary["identifiable"]}
        worth["not_identified"] = designed.summary["not_identifiable"]
        page.write(folder / "plan.html", nominal, stands, designed.motions, Clearance(nominal, stands), worth)
    known, weak = list(designed.summary["identifiable"]), list(designed.summary["not_identifiable"])
    claims = [
        Claim("duration", {"seconds": float(designed.duration)}),
        Claim("known", {"names": known, "of": len(known) + len(weak)}),
        Claim("condition", {"condition": float(designed.worth.condition)}),
    ]
    if "gap_estimate_nats" in designed.summary:
        gap = {"nats": designed.summary["gap_estimate_nats"], "share": designed.summary["gap_estimate_std_share"]}
        claims.append(Claim("information_gap", gap))
    if "separation_sigma" in designed.summary:
        claims.append(Claim("separation", {"sigma": float(designed.summary["separation_sigma"]), "enough": ENOUGH}))
    sentence = in_one_sentence(claims)
    then: list[str | Path] = ["record", cell or "CELL", folder]
    conclude(sentence)
    if as_json:
        motions = [{"name": m.name, "kind": m.kind, "duration": m.trajectory.duration} for m in designed.motions]
        console.print_json({"schema": "plan/1", "folder": folder, "motions": motions, **designed.summary,
                            "first_run_seconds": duration_of(designed.motions), "outcome": sentence, "claims": [claim.as_dict() for claim in claims], "next": console.command_line(then)})  # fmt: skip
        return
    console.table(
        ["motion", "kind", "duration [s]", "samples"],
        [[m.name, m.kind, m.trajectory.duration, len(m.trajectory)] for m in designed.motions],
    )
    console.say(f"{sentence}.")
    console.say(f"With the slow stages of the first run on an arm: {duration_of(designed.motions) / 60:.0f} minutes.")
    console.say(f"{folder}: plan.toml, plan.html. Look at plan.html; `calib record` asks for your approval.")
    console.next_step(then)
    if viewer:
        play(nominal, stands.table.obstacles, [m.trajectory for m in designed.motions])
