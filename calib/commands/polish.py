"""`calib polish`: small corrections of friction and offsets that bring simulated motion closer to recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from calib.run_folder import conclude, new_run, require_free
from calib.terminal import console, options

LIST_OPTIONS = ("--holdout",)


def command(
    arm: options.ArmOrLogArgument,
    log: options.LogsArgument = None,
    holdout: Annotated[
        list[Path] | None,
        typer.Option(
            "--holdout", metavar="LOG", help="Recordings that decide whether the correction is accepted, one or several."
        ),
    ] = None,
    accept_partial: options.AcceptPartial = False,
    assume: options.Assume = None,
    out: options.Out = None,
    as_json: options.Json = False,
    configs: options.Configs = None,
) -> int:
    """Correct friction and torque offsets of an identified arm so that its simulated motion stays closer to recordings.

    identify and diagnose minimise the torque error; polish minimises the motion error after 1 s under the measured torque.
    Writes polish.json. Exit code 0: the held-out recordings are followed at least 2 % better, and arm/ is written. 1: they are not, and
    no arm is written.

    Example:

        calib polish runs/first/arm excitation.mcap --holdout validation.mcap
    """
    from calib.gate.commands import require
    from calib.measurement.preprocessing import prepare
    from calib.newest_arm import named
    from calib.terminal.recordings import arm_and_logs, read_logs, require_unseen
    from calib.validation.polish import POLISHED, polish
    from sim.arm_folder import write_arm
    from sim.errors import ConfigError
    from sim.units import headed

    arm = named(arm)
    subject, given = arm_and_logs(arm, log, configs)
    if not holdout:
        raise ConfigError(
            "a polish is accepted only on recordings that are not fitted; name one of another motion with --holdout"
        )
    require_unseen(given, holdout)
    require_free(out)
    with console.progress("polish") as advance:
        logs, held = (read_logs(paths, subject, accept_partial, assume) for paths in (given, holdout))
        folder = new_run(subject, "polish", out)
        require(subject, [*logs, *held])
        found = polish(
            subject,
            [prepare(one, subject) for one in logs],
            [prepare(one, subject) for one in held],
            lambda stage, share: advance(0, f"{stage} {share:.0%}"),
        )
        if found.accepted:
            write_arm(folder / "arm", subject, effects=found.arm.effects)
        (folder / "polish.json").write_text(json.dumps(found.as_dict(), indent=2) + "\n", encoding="utf-8")
    conclude(found.sentence)
    then: list[str | Path] = ["validate", folder / "arm" if found.accepted else arm, Path("OTHER_RECORDING")]
    then += options.read_as(accept_partial, assume, configs)
    code = 0 if found.accepted else 1
    if as_json:
        console.print_json({**found.as_dict(), "next": console.command_line(then)})
        return code
    change = dict(zip(found.keys, found.theta.tolist(), strict=True))
    units = {"coulomb_friction": "N m", "viscous_friction": "N m s/rad", "torque_offset": "N m"}
    titles = ["joint", *(f"{POLISHED[effect]} [{unit}]" for effect, unit in units.items()), "before [mrad]", "after [mrad]"]
    console.table(
        headed(titles, subject.tree.prismatic),
        [
            [
                joint,
                *(change.get((effect, joint), float("nan")) for effect in units),
                1e3 * found.before[j],
                1e3 * found.after[j],
            ]
            for j, joint in enumerate(subject.joint_names)
        ],
        "corrections, and simulated motion on the held-out recordings",
    )
    console.conclusion(found.sentence, [])
    console.say(f"{folder}: {'arm/, ' if found.accepted else ''}polish.json")
    console.next_step(then)
    return code
