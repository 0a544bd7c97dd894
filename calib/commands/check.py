"""`calib check CELL`: connect, and check the device before anything moves."""

from __future__ import annotations

from contextlib import closing, nullcontext
from typing import TYPE_CHECKING, Annotated

import typer

from calib.run_folder import SIMULATED, conclude, lock_cell
from calib.terminal import console, options
from sim.errors import AnswerIsNo, SafetyStop

if TYPE_CHECKING:
    from drivers.driver import Check
    from sim.arm import Arm
    from sim.cell import Cell

_WORDS = {True: "ok", False: "NO", None: "noted"}


def command(
    cell: options.CellArgument,
    seconds: Annotated[float, typer.Option(min=0.1, max=60.0, help="How long to watch rate and clock.")] = 2.0,
    move: Annotated[
        bool,
        typer.Option(
            "--move",
            help="Then turn every joint by two degrees and back, and visit nearby poses, to check order, direction, torque and arm.",
        ),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --move: do not ask; only for mock and emulated cells.")] = False,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Check the arm of a cell before motion: identity, state, firmware, program, limits, payload, mounting, clock, rate.

    Only reads. With --move it then takes control of the arm, and says so. Exit code 1 if a check fails; every failure states what to do.

    Example:

        calib check emulated-ur10e
    """
    from calib.terminal.confirming import confirm
    from drivers import driver_origin, open_driver
    from drivers.preflight import preflight
    from safety import realtime
    from safety.confirmation import check_yes
    from safety.joint_test import try_joints
    from safety.stop_sources import StopSignals
    from sim.cell import load_arm_of, load_cell
    from sim.plugins import OWN, arm_origin

    table = load_cell(cell, configs)
    arm = load_arm_of(table, configs)
    console.warn_assumed(table)
    if move and yes:
        check_yes(table)
    elif move:
        confirm(table, arm.name, "every joint by two degrees and back, then all of them by up to half a radian")
    if driver_origin(table.table.driver) != OWN and not as_json:
        console.say(f"driver {table.table.driver} comes from {driver_origin(table.table.driver)}")
    if (source := arm_origin(table.table.arm, arm.model_path)) != OWN and not as_json:
        console.say(f"arm {table.table.arm} comes from {source}")
    lock_cell(table)
    with console.progress(f"asking the device of {table.name}") as show, StopSignals() as signals:
        waits = table.table.driver not in ("mock", "replay")
        with realtime.prepared() if waits else nullcontext(), closing(open_driver(table, arm)) as driver:
            driver.info = driver.inspect()
            checks = [*preflight(driver, table, seconds), _settings(arm, table)]
            if move and all(check.ok is not False for check in checks):
                console.warn_control(table, driver)
                show(0, "verifying the motions; nothing moves yet", True)
                with driver:
                    checks += try_joints(driver, table, signals.reason, lambda what: show(0, moving(what), True))
    failed = [check for check in checks if check.ok is False]
    noted = sum(check.ok is None and not check.name.startswith("assumed: ") for check in checks)
    passed = sum(check.ok is True for check in checks)
    outcome = f"{passed} checks pass" + (f"; {noted} noted, without a verdict" if noted else "")
    conclude(outcome)
    # a mock turns the way its model does; on any other device the joints are tested before larger motions
    then = ["plan", table.table.arm, "--cell", cell] if move or table.table.driver in SIMULATED else ["check", cell, "--move"]
    if as_json:
        console.print_json({"schema": "check/1", "cell": table.name, "ok": not failed, "checks": checks})
    else:
        console.table(["check", "", "found"], [[check.name, _WORDS[check.ok], check.detail] for check in checks])
        for check in failed:
            console.say(f"{check.name}: {check.remedy}")
    if failed:
        raise AnswerIsNo(
            f"{table.name}: {', '.join(c.name for c in failed)}: must be put right before motion; see the remedies"
        )
    if not as_json:
        console.say(f"{outcome}.")
        console.next_step(then)


def moving(what: str) -> str:
    """The live line while the arm moves; `what` up to its first comma, so that the line fits a terminal of 80 columns."""
    return f"MOVING {what.partition(',')[0]}; Ctrl-C stops"


def _settings(arm: Arm, cell: Cell) -> Check:
    """What `calib plan` refuses before it plans: a payload without a shape, and settings that switch a rule off."""
    from drivers.driver import Check
    from safety.plausible import check_plausible
    from sim.stated_facts import missing_limits

    if missing := missing_limits(arm):
        return Check(
            "settings", None, f"needed before any motion, and not stated: {', '.join(missing)} in [limits] of arm.toml"
        )
    try:
        check_plausible(arm, cell)
    except SafetyStop as refusal:
        detail, _, remedy = str(refusal).partition("; ")
        return Check("settings", False, detail, remedy)
    load = cell.table.payload
    shape = ", and the payload has a shape" if load is not None and load.mass > 0 and cell.table.tool else ""
    return Check("settings", True, f"limits and tolerances of arm and cell are in the usual range{shape}")
