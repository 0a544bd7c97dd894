"""`calib record CELL PLAN`: run an approved plan under guard and record it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from calib.past_runs import LATEST, RUNS, latest, runs_and_faults
from calib.run_folder import conclude, lock_cell, login_name, new_run
from calib.terminal import console, options

DECIDES = "discriminate"  # the motion that decides between effects, for the diagnosis that left them open


def command(
    cell: options.CellArgument,
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN", help="Folder that `calib plan` wrote, or `latest`.", autocompletion=options.run_folders("plan")
        ),
    ],
    approve_again: Annotated[
        bool, typer.Option("--approve", help="Re-approve a plan whose approval has expired or was given for another cell.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; only for mock and emulated cells.")] = False,
    hold_to_run: Annotated[
        bool, typer.Option("--hold-to-run", help="Move only while the space bar is held down; releasing it stops the arm.")
    ] = False,
    operator: Annotated[str | None, typer.Option(help="Name for the audit trail; the login name if not given.")] = None,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Run the motions of a plan and record them, slowly first; every motion is verified again before anything moves.

    Writes one log per motion. This is not a safety-rated function: it does not replace the emergency stop.

    Example:

        calib record mock-ur10e runs/plan --yes --out runs/recorded
    """
    from calib.guided import HELD_OUT
    from calib.terminal.confirming import confirm
    from calib.terminal.halt_key import HaltKey
    from calib.terminal.live import LiveView, show
    from drivers import open_driver
    from safety import approval_of, approve, check_approval, check_plan, load_plan
    from safety.confirmation import check_yes
    from safety.control import alone_because, drive, is_simulated
    from safety.hold_key import HoldKey
    from safety.stages import duration_of, stages_due
    from safety.stop_sources import first_reason
    from sim.cell import load_arm_of, load_cell
    from sim.errors import ConfigError
    from sim.resources import nearest
    from sim.units import of_joints

    where = load_cell(cell, configs)
    arm = load_arm_of(where, configs)
    console.warn_assumed(where)
    if str(plan) == LATEST and not plan.exists():
        plan = latest("plan").folder
    if not plan.is_dir():
        plans = [str(run.folder) for run in runs_and_faults()[0] if run.verb == "plan"]
        raise ConfigError(
            f"there is no plan folder {str(plan)!r}; {nearest(str(plan), plans)}; `calib plan {where.table.arm} --cell {cell}` makes one"
        )
    lock_cell(where)
    sealed = load_plan(plan)
    check_plan(sealed, arm, where)
    if yes:
        check_yes(where)
    who = login_name(operator)
    approval = None if approve_again else approval_of(sealed)
    if approval is not None:
        check_approval(approval, sealed, arm, where, datetime.now(UTC))
    if not yes:
        rows = [[m.name, m.kind, m.trajectory.duration] for m in sealed.motions]
        console.table(["motion", "kind", "duration at full speed [s]"], rows)
        due = stages_due(sealed, arm, where, RUNS / "audit.jsonl")
        speeds = ", ".join(f"{speed:.0%}" for speed in due)
        console.say(f"Stages at {speeds} of the speed: {duration_of(sealed.motions, due) / 60:.0f} minutes of motion.")
        confirm(where, arm.name)
    if approval is None:
        approve(sealed, arm, where, who, datetime.now(UTC))
    console.warn_control(where, open_driver(where, arm))
    if not is_simulated(where):
        console.warn_watched(where, alone_because(open_driver, where, arm))
    folder = new_run(arm, "record", out, where, plan=str(sealed.folder), plan_sha256=sealed.sha256, operator=who)
    halt = HaltKey(None if hold_to_run else sys.stdin)
    keys = {"release the space bar": "stop"} if hold_to_run else {"h": "stop"} if halt.listening else {}
    view = LiveView(
        arm,
        f"{arm.name} in {where.name}, recorded to {folder}",
        keys | {"Ctrl-C": "stop"},
        where.table.motion.following_error_max,
    )
    with HoldKey(sys.stdin if hold_to_run else None) as hold, halt, view:
        done = drive(
            sealed,
            where,
            arm,
            open_driver,
            folder,
            audit=RUNS / "audit.jsonl",
            operator=who,
            stop_requested=first_reason(hold.reason, halt.reason),
            watch=lambda progress: show(view, progress, folder),
            held=console.warn,
        )
    worst = max(max(stage.following_error) for stage in done.stages)
    outcome = (
        f"recorded {', '.join(done.logs)}; largest following error {1000 * worst:.1f} {of_joints('mrad', arm.tree.prismatic)}"
    )
    conclude(outcome)
    if as_json:
        console.print_json({"schema": "record/1", **console.plain(done)})
        return
    console.table(
        ["speed", *arm.joint_names],
        [[f"{s.speed:.0%}", *s.following_error] for s in done.stages],
        f"largest following error [{of_joints('rad', arm.tree.prismatic)}]",
    )
    console.table(
        [
            "motion",
            "limit used most",
            "share",
            "nearest to the cell",
            "nearest to itself",
            f"room beside the path [{of_joints('mrad', arm.tree.prismatic)}]",
            "longest stop [s]",
        ],
        [
            [name, *_most(v.used), v.near.get("the cell"), v.near.get("itself"), 1000 * v.room, v.stop_time]
            for name, v in done.verdicts.items()
        ],
        "verified before it moved",
    )
    console.conclusion(outcome, [])
    console.say(f"{folder}: {', '.join(p.name for p in done.logs.values())}")
    fitted, held = ([log for log in done.logs.values() if (log.name == HELD_OUT) is unseen] for unseen in (False, True))
    if fitted:
        then: list[str | Path] = ["diagnose" if DECIDES in done.logs else "identify", where.table.arm, *fitted]
        then += ["--holdout", *held] if held else []
        console.next_step(then)


def _most(used: Mapping[str, float]) -> tuple[str, str]:
    """The limit that a motion uses most, and its share of it."""
    name, share = max(used.items(), key=lambda item: item[1])
    return name, f"{share:.0%}"
