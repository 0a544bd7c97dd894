"""`calib servo CELL`: the drives of a CAN arm one by one, without moving them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from calib import console
from sim.errors import AnswerIsNo, ConfigError

if TYPE_CHECKING:
    from drivers.can_servo.service import Look


def command(
    cell: console.CellArgument,
    joint: Annotated[str | None, typer.Argument(metavar="JOINT", help="one joint; all of them if not given")] = None,
    clear: Annotated[bool, typer.Option(help="clear the latched error of this joint's drive")] = False,
    zero: Annotated[
        bool, typer.Option(help="make the present angle of this joint its zero; the drive must be off and still")
    ] = False,
    off: Annotated[bool, typer.Option(help="torque off for this joint")] = False,
    supported: Annotated[bool, typer.Option(help="the arm is carried: without brakes, torque off drops it")] = False,
    as_json: console.Json = False,
    configs: console.Configs = None,
) -> None:
    """Look at the drives of a servo arm: serial number, watchdog, position, temperature, error; or set one of them.

    Switches no torque on. Exit code 1 where a drive reports an error or is not the one of the cell file. Example:

        calib servo emulated-servo6 elbow_joint
    """
    from drivers.can_servo.service import Service
    from sim.arm import load_arm
    from sim.cell import load_cell

    table = load_cell(cell, configs)
    arm = load_arm(table.table.arm, configs)
    console.warn_assumed(table)
    orders = [name for name, wanted in (("clear", clear), ("zero", zero), ("off", off)) if wanted]
    if len(orders) > 1 or (orders and joint is None):
        raise ConfigError("an order is for one joint: calib servo CELL JOINT with one of --clear, --zero, --off")
    if table.table.driver != "can_servo":
        raise ConfigError(
            f"{table.path}: driver = {table.table.driver!r} has no servo drives to look at; this is for can_servo cells"
        )
    names = arm.joint_names if joint is None else (arm.joint_names[arm.joint_index(joint)],)
    with console.progress("asking the drives"), Service.from_cell(table, arm) as service:
        if orders:
            service.do(names[0], orders[0], supported)  # type: ignore[arg-type]
        looks = [service.look(name) for name in names]
    if as_json:
        console.print_json({"schema": "servo/1", "cell": table.name, "drives": [_plain(look) for look in looks]})
    else:
        console.table(
            ["joint", "serial", "state", "angle rad", "torque N*m", "degC", "watchdog ms", "angle range rad", "torque range N*m"],
            [
                [k.joint, k.identity.serial or "not told", _state(k), k.reading.q, k.reading.tau, k.reading.temperature,
                 1e3 * k.identity.watchdog, k.identity.ranges.q, k.identity.ranges.tau]
                for k in looks
            ],
        )  # fmt: skip
    bad = [f"{k.joint}: {k.reading.error or k.serial_problem}" for k in looks if k.reading.error or k.serial_problem]
    if bad:
        raise AnswerIsNo("; ".join(bad))


def _state(look: Look) -> str:
    if look.reading.error:
        return look.reading.error
    return {True: "on", False: "off", None: "not told"}[look.reading.on]


def _plain(look: Look) -> dict[str, object]:
    return {
        "joint": look.joint, "serial": look.identity.serial, "serial_problem": look.serial_problem, "firmware": look.identity.firmware,
        "watchdog": look.identity.watchdog, "ranges": look.identity.ranges.model_dump(), "q": look.reading.q, "tau": look.reading.tau,
        "temperature": look.reading.temperature, "on": look.reading.on, "error": look.reading.error,
    }  # fmt: skip
