"""`calib arm new FILE`: a working arm folder from a model file; `calib arm drive NAME`: one drive on a bench."""

from __future__ import annotations

import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.terminal import console, options
from calib.terminal.arm_options import At, Drive, Folder, Limit, Name, Numbers, Spring, TorqueAt, locked_joint, numbers_of
from calib.terminal.group import Group
from calib.terminal.quantity import significant
from sim.errors import ConfigError

if TYPE_CHECKING:
    from sim.arm import Arm

app = typer.Typer(rich_markup_mode=None, add_completion=False, cls=Group)


@app.callback()
def command() -> None:
    """Add an arm: from a model file, from a UR controller, or one drive on a bench.

    Example:

        calib arm new my_robot.urdf
    """


@app.command()
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="MJCF (.xml) or URDF (.urdf; expand a .xacro first).")],
    name: Name = None,
    limit: Limit = None,
    drives: Drive = None,
    springs: Spring = None,
    joints: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Joints that move, by name or pattern; the others are fixed at 0.")
    ] = None,
    lock: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=N]", help="A joint, or a pattern of joints, to be fixed at N rad (m for a slide). Repeatable."
        ),
    ] = None,
    tool: Annotated[
        str | None, typer.Option(metavar="LINK", help="The arm's last link; joints that are not before it are fixed.")
    ] = None,
    numbers: Annotated[
        Numbers | None,
        typer.Option(help="Source of the file's masses; asked for if not given, and counted as guessed without an answer."),
    ] = None,
    geometry_only: Annotated[
        bool, typer.Option("--geometry-only", help="Only geometry is known: masses in the file, if any, are ignored.")
    ] = False,
    no_shapes: Annotated[
        bool,
        typer.Option("--no-shapes", help="Leave out collision shapes whose mesh is missing; nothing keeps those parts clear."),
    ] = False,
    torque_at: At = TorqueAt.MOTOR,
    root: Annotated[Path | None, typer.Option(help="Folder of the ROS package for package:// mesh paths.")] = None,
    out: Folder = None,
    json: options.Json = False,
) -> None:
    """Create an arm folder from a model file, and ask for each limit that the model does not state.

    No limit is guessed: an empty answer leaves it out, and a command that needs it asks for it by name. Without a terminal
    nothing is asked; give --limit instead. Unknown friction and reflected inertia are assumed to be those of an ordinary
    drive, until --drive states them. Leave out a gripper's joints with --joints, --lock or --tool.

    Example:

        calib arm new my_robot.urdf --numbers cad --lock 'finger_*' --limit ddq_max=5 --limit jerk_max=100
    """
    from calib.excitation.home import FREE, free_share
    from sim.new_arm import Choice, read_model, staging_folder
    from sim.stated_facts import with_drives, with_springs

    person = sys.stdin.isatty() and not json
    if numbers is None and not geometry_only and person:
        numbers = _entered_source()
    choice = Choice(
        joints=[p.strip() for p in joints.split(",") if p.strip()] if joints else (), lock=dict(locked_joint(text) for text in lock or []),
        tool=tool, no_shapes=no_shapes, geometry_only=geometry_only or numbers == Numbers.UNKNOWN, numbers=numbers.value if numbers else None,
    )  # fmt: skip
    with staging_folder() as staging:
        arm, notes = read_model(file, Path(staging), root, choice)
        if file.suffix.lower() == ".urdf" and "shapes" not in arm.incomplete and free_share(arm) < FREE:
            hulls = Path(staging) / "hulls"
            hulls.mkdir()
            arm, notes = read_model(file, hulls, root, replace(choice, hulls=True))
            notes.append(
                "with capsules it has almost no free posture, so its shapes are convex pieces, and verification takes longer"
            )
        for note in notes:
            console.warn(note)
        if arm.prior.numbers is None:
            console.warn("the source of the masses is unknown, so they count as guessed; state it with --numbers")
        arm = with_drives(arm, dict(numbers_of("--drive", text) for text in drives or []))
        arm = with_springs(arm, dict(numbers_of("--spring", text, "JOINT=K,Q0") for text in springs or []))
        _finish(arm, name, limit, torque_at, out, json, person, notes, file.name)


@app.command()
def drive(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the one-joint arm.")],
    load: Annotated[
        str | None,
        typer.Option(
            metavar="KG,M",
            help="Load and its distance from a level axis, hanging straight down at 0 rad; `unknown`: not weighed.",
        ),
    ] = None,
    joint: Annotated[str, typer.Option(help="Name of its joint.")] = "joint1",
    limit: Limit = None,
    torque_at: At = TorqueAt.MOTOR,
    out: Folder = None,
    json: options.Json = False,
) -> None:
    """Create an arm folder for one drive on a bench: a free shaft, or a load on a lever.

    Example:

        calib arm drive xl330 --load 0.49,0.1 --limit tau_max=0.5 --limit dq_max=6
    """
    from sim.new_arm import drive_arm, staging_folder

    known = None if load in (None, "unknown") else numbers_of("--load", f"load={load}")[1]
    if known is not None and (len(known) != 2 or not min(known) > 0 or not max(known) < 1e4):
        raise ConfigError(f"--load {load}: write KG,M, both above zero, or unknown")
    with staging_folder() as staging:
        arm = drive_arm(name, joint, None if known is None else (known[0], known[1]), load == "unknown", Path(staging))
        _finish(arm, name, limit, torque_at, out, json, sys.stdin.isatty() and not json, [], "`calib arm drive`")


@app.command()
def read(
    cell: options.CellArgument,
    out: Folder = None,
    json: options.Json = False,
    configs: options.Configs = None,
) -> None:
    """Read the kinematics and limits that a UR controller holds for its arm, and write them as an arm folder of that robot.

    Only listens. The folder is named after the arm and its serial number; masses and all else are those of the cell's arm.

    Example:

        calib arm read emulated-ur10e
    """
    from drivers.ur_rtde.driver import UrDriver
    from drivers.ur_rtde.own_folder import moved, write_own
    from drivers.ur_rtde.primary import own_arm
    from sim.cell import load_arm_of, load_cell

    table = load_cell(cell, configs)
    if table.table.driver != "ur_rtde":
        raise ConfigError(f"{table.path}: driver = {table.table.driver!r}: only a UR controller holds its arm's kinematics")
    arm = load_arm_of(table, configs)
    driver = UrDriver.from_cell(table, arm)
    with console.progress(f"listening to {table.name}"), closing(driver):
        serial = driver.inspect().serial or "serial-not-reported"
        own = own_arm(driver.options.host)
    written = write_own(out or Path("configs") / "arms" / f"{arm.name}-{serial}", arm, own, serial)
    folder, far = written.model_path.parent, moved(arm, own)
    if json:
        console.print_json(
            {"arm": written.name, "folder": folder, "serial": serial, "checksum": own.checksum, "moved": far.tolist()}
        )
        return
    rows = zip(written.joint_names, 1e3 * far, written.q_min, written.q_max, written.dq_max, strict=True)
    console.table(["joint", "moved from nominal mm", "q_min rad", "q_max rad", "dq_max rad/s"], rows)
    console.say(f"{folder}: use it with arm = {written.name!r} in {table.path.name}")


def _finish(
    arm: Arm, name: str | None, limit: list[str] | None, torque_at: TorqueAt, out: Path | None, json: bool, person: bool,
    notes: list[str], source: str,
) -> None:  # fmt: skip
    """Give the arm its limits, write its folder and show what is in it."""
    from sim.arm_folder import write_arm
    from sim.files import is_name
    from sim.stated_facts import LIMIT_UNITS, limit_sources, missing_limits, with_limits
    from sim.units import of_joints

    own = arm
    arm = with_limits(arm, dict(numbers_of("--limit", text) for text in limit or []))
    if person:
        arm = _with_entered_limits(arm)
    label = name or arm.name
    if not is_name(label):
        raise ConfigError(f"name {label!r}: 1 to 64 letters, digits, dots, dashes and underscores; give one with --name")
    folder = out or Path("configs") / "arms" / label
    if (folder / "arm.toml").exists():
        raise ConfigError(f"{folder} is already an arm; remove it first, or give another --name or --out")
    provenance = {"all": f"read from {source}", "limits": limit_sources(own, arm, source)}
    if "shapes" in arm.incomplete:
        console.warn("no motion is cleared until these shapes are in the model; to do without them, give --no-shapes")
    provenance |= {"left out": "; ".join(notes)} if notes else {}
    written = write_arm(folder, replace(arm, torque_at=torque_at.value), name=label, provenance=provenance)
    if json:
        console.print_json(
            {"arm": label, "folder": folder, "joints": written.joint_names, "missing": missing_limits(written), "notes": notes}
        )
        return
    masses, mass = list(written.tree.mass), "mass kg"
    if written.prior.numbers == "unknown":  # four digits would claim a measurement
        masses, mass = [f"~{significant(m)}" for m in masses], "mass kg (stand-in)"
    rows = zip(written.joint_names, masses, *(getattr(written, key) for key in LIMIT_UNITS), strict=True)
    console.table(
        ["joint", mass, *(f"{key} {of_joints(unit, written.tree.prismatic)}" for key, unit in LIMIT_UNITS.items())], rows
    )
    missing = missing_limits(written)
    if missing:
        console.warn(f"not stated, and needed before any motion: {', '.join(missing)}; write them to {folder / 'arm.toml'}")
    console.say(f"limits: {provenance['limits']}")
    console.say(f"{folder}")


def _entered_source() -> Numbers | None:
    """Where the masses of a model file come from, asked until the answer is one of the words, or empty."""
    question = f"where do the masses in the file come from? {', '.join(Numbers)}; with `{Numbers.UNKNOWN}` they are ignored, empty counts as guessed: "
    while answer := console.ask(question).strip().lower():
        if answer in list(Numbers):
            return Numbers(answer)
        console.warn(f"{answer!r} is not one of {', '.join(Numbers)}; answer again")
    return None


def _with_entered_limits(arm: Arm) -> Arm:
    from sim.stated_facts import LIMIT_UNITS, missing_limits, with_limits

    how = f"one number, or {arm.n} with commas between them" if arm.n > 1 else "one number"
    for key in missing_limits(arm):
        while answer := console.ask(f"{key} in {LIMIT_UNITS[key]}, {how}; empty to leave it out: ").strip():
            try:
                arm = with_limits(arm, {key: [float(x) for x in answer.split(",")]})
                break
            except ConfigError as error:
                console.warn(f"{error}; answer again")
            except ValueError:
                console.warn(f"{answer!r} is not {how}; answer again")
    return arm
