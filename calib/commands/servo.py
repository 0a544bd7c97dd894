"""`calib servo CELL`: the drives of a CAN arm one by one, without moving them; `calib servo scan`: find them on a bus."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.run_folder import lock_cell
from calib.terminal import console, options
from calib.terminal.group import Group
from calib.terminal.turned_by_hand import drives_of_joints
from sim.errors import AnswerIsNo, ConfigError, DeviceError
from sim.files import is_name

if TYPE_CHECKING:
    from drivers.can_servo.scan import Found
    from drivers.can_servo.service import Look

ON = {True: "on", False: "off", None: "not reported"}


class CellOrVerb(Group):
    """Treats a first word that is not a subcommand as a cell to look at."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        return super().resolve_command(ctx, args if args[0] in self.commands else ["look", *args])


app = typer.Typer(rich_markup_mode=None, add_completion=False, cls=CellOrVerb)


@app.callback()
def command() -> None:
    """Look at the drives of a servo arm, set one of them (calib servo CELL ...), or find them on a bus (calib servo scan).

    Example:

        calib servo emulated-servo6 elbow_joint
    """


@app.command()
def look(
    cell: options.CellArgument,
    joint: Annotated[str | None, typer.Argument(metavar="JOINT", help="One joint; all of them if not given.")] = None,
    clear: Annotated[bool, typer.Option(help="Clear the latched error of this joint's drive.")] = False,
    zero: Annotated[
        bool, typer.Option(help="Make the present angle of this joint its zero; the drive must be off and still.")
    ] = False,
    off: Annotated[bool, typer.Option(help="Switch torque off for this joint.")] = False,
    supported: Annotated[
        bool,
        typer.Option(
            help="The arm is supported: without brakes, torque off drops it, and some drives answer only that command."
        ),
    ] = False,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Look at the drives of a servo arm: serial number, watchdog, position, temperature, error; or set one of them.

    Switches no torque on. Exit code 1 if a drive reports an error or is not the one of the cell file.

    Example:

        calib servo emulated-servo6 elbow_joint
    """
    from drivers.can_servo.service import Service
    from sim.cell import load_arm_of, load_cell

    table = load_cell(cell, configs)
    arm = load_arm_of(table, configs)
    console.warn_assumed(table)
    orders = [name for name, wanted in (("clear", clear), ("zero", zero), ("off", off)) if wanted]
    if len(orders) > 1 or (orders and joint is None):
        raise ConfigError("a command is for one joint: calib servo CELL JOINT with one of --clear, --zero, --off")
    if table.table.driver != "can_servo":
        raise ConfigError(
            f"{table.path}: driver = {table.table.driver!r} has no servo drives to look at; this is for can_servo cells"
        )
    names = arm.joint_names if joint is None else (arm.joint_names[arm.joint_index(joint)],)
    lock_cell(table)
    with console.progress("asking the drives"), Service.from_cell(table, arm) as service:
        if orders:
            service.do(names[0], orders[0], supported)  # type: ignore[arg-type]
        looks = [service.look(name, supported) for name in names]
    if as_json:
        console.print_json({"schema": "servo/1", "cell": table.name, "drives": [_plain(look) for look in looks]})
    else:
        console.table(
            ["joint", "serial", "state", "angle rad", "torque N m", "degC", "watchdog ms", "angle range rad", "torque range N m"],
            [
                [k.joint, k.identity.serial or "not reported", _state(k), round(k.reading.q, 3), round(k.reading.tau, 2), k.reading.temperature,
                 _watchdog(k.identity.watchdog), k.identity.ranges.q, k.identity.ranges.tau]
                for k in looks
            ],
        )  # fmt: skip
        if any(k.identity.watchdog == 0.0 for k in looks):
            console.say(
                "watchdog off: before any motion it is set to that of the cell file; a drive on which it stays off is refused."
            )
    bad = [f"{k.joint}: {k.reading.error or k.serial_problem}" for k in looks if k.reading.error or k.serial_problem]
    if bad:
        raise AnswerIsNo("; ".join(bad))


@app.command()
def scan(
    interface: Annotated[
        str, typer.Option(help="python-can interface: socketcan, slcan, socketcand, pcan, ...; damiao is Damiao's USB adapter.")
    ],
    channel: Annotated[str, typer.Option(help="can0, /dev/serial/by-id/..., as the interface names it.")],
    bitrate: Annotated[int, typer.Option(min=1, max=1_000_000, help="bit/s: 1000000, 500000, 250000 or 125000.")] = 1_000_000,
    data_bitrate: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=8_000_000,
            help="bit/s of CAN FD data: 2000000, 4000000, 5000000 (often) or 8000000; asks classical and CAN FD drives. Classical only if not given.",
        ),
    ] = None,
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="More python-can options, such as host=127.0.0.1 and port=29536. Repeatable."),
    ] = None,
    supported: Annotated[
        bool, typer.Option(help="The arm is supported: also ask with the command off, which CubeMars drives need.")
    ] = False,
    arm: Annotated[
        str | None, typer.Option(metavar="ARM", help="Arm whose joints are then turned by hand, one by one.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Cell file to write, with --arm.")] = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Find the drives on a bus: makers, identifiers, serial numbers, firmware, ranges, classical and CAN FD. Switches no torque on.

    With --arm each joint is turned by hand, which shows its drive and direction, and --out writes the cell. Exit code 1 if a drive must be
    configured before it can be used.

    Example:

        calib servo scan --interface socketcan --channel can0 --data-bitrate 5000000
    """
    from drivers.can_servo.by_hand import ByHand
    from drivers.can_servo.link import Link
    from drivers.can_servo.new_cell import cell_text
    from drivers.can_servo.scan import scan as scanned
    from sim.arm import load_arm
    from sim.can_wiring import CanOptions
    from sim.clock import MonotonicClock
    from sim.strict import validated

    model = load_arm(arm, configs) if arm else None
    if (model is None) != (out is None):
        raise ConfigError(
            "--arm and --out belong together: a cell names its arm and joints; give both, or neither for the scan alone"
        )
    if out is not None:  # before anybody turns a joint
        if out.exists():
            raise ConfigError(f"{out}: exists already and is never overwritten; name a new file, or remove it")
        if out.suffix != ".toml" or not is_name(out.stem):
            raise ConfigError(
                f"{out}: a cell's file ends in .toml, and {out.stem!r} must be letters, digits, dots, dashes and underscores; "
                "give a name like cells/servo.toml"
            )
        out.parent.mkdir(parents=True, exist_ok=True)
    options_table = {
        "interface": interface, "channel": channel, "bitrate": bitrate, "data_bitrate": data_bitrate, "bus": options.pairs("--bus", bus or []),
        "rate": 200.0, "brakes": False, "servos": [],
    }  # fmt: skip
    wiring, clock = validated(CanOptions, options_table, Path("calib servo scan")), MonotonicClock()
    link = Link.open(wiring, clock)
    try:
        with console.progress(f"asking all drives on {interface} {channel}"):
            result = scanned(link, clock, wiring, supported)
        found = result.found
        if not as_json:
            console.table(
                ["drive", "frames", "serial", "firmware", "state", "angle rad", "watchdog ms", "ranges rad, rad/s, N m"],
                [[f.name, "FD" if f.fd else "classical", f.described.serial or "not reported", f.described.firmware, ON[f.described.on], round(f.described.q, 3),
                  _watchdog(f.described.watchdog), _ranges(f)] for f in found],
            )  # fmt: skip
            for note in result.notes:
                console.say(note)
        if not found:
            raise DeviceError(
                f"{interface} {channel}: no drive answered at {bitrate} bit/s; check supply, cable, termination and bit rate, and ask again with "
                "--data-bitrate 5000000 for CAN FD drives, --supported for CubeMars"
            )
        if model is not None and out is not None:
            joints = drives_of_joints(model, found, ByHand([f.drive for f in found], link, clock))
            text = cell_text(out.stem, _named(str(arm), out), wiring, joints)
            with out.open("x", encoding="utf-8") as file:
                file.write(text)
    finally:
        link.close()
    if as_json:
        console.print_json({
            "schema": "scan/1", "drives": [_described(f) for f in found], "notes": result.notes, "cell": out,
        })  # fmt: skip
    elif out is not None:
        console.say(f"{out}: written; complete its TODO lines, then: calib check {out}")
    problems = [problem for f in found for problem in f.described.problems]
    if problems:
        raise AnswerIsNo("; ".join(problems))


def _named(arm: str, cell: Path) -> str:
    """An arm as a cell file names it: its name, or its path relative to the cell file."""
    return arm if is_name(arm) else f"./{Path(os.path.relpath(arm, cell.parent)).as_posix()}"


def _watchdog(seconds: float) -> float | str:
    return "off" if seconds == 0.0 else 1e3 * seconds


def _ranges(found: Found) -> str:
    r = found.described.ranges
    return "not reported" if r is None else f"{r.q:g} {r.dq:g} {r.tau:g}"


def _described(found: Found) -> dict[str, object]:
    t = found.described
    return {
        "protocol": found.protocol, "node": found.node, "feedback": found.feedback, "fd": found.fd, "serial": t.serial, "firmware": t.firmware,
        "watchdog": t.watchdog, "ranges": t.ranges.model_dump() if t.ranges else None, "on": t.on, "q": t.q, "problems": t.problems,
    }  # fmt: skip


def _state(look: Look) -> str:
    if look.reading.error:
        return look.reading.error
    return ON[look.reading.on]


def _plain(look: Look) -> dict[str, object]:
    return {
        "joint": look.joint, "serial": look.identity.serial, "serial_problem": look.serial_problem, "firmware": look.identity.firmware,
        "watchdog": look.identity.watchdog, "ranges": look.identity.ranges.model_dump(), "q": look.reading.q, "tau": look.reading.tau,
        "temperature": look.reading.temperature, "on": look.reading.on, "error": look.reading.error,
    }  # fmt: skip
