"""`calib init`: find what is connected, and write the first cell."""

from __future__ import annotations

import ipaddress
import shlex
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.terminal import console, options
from sim.errors import AnswerIsNo, ConfigError

if TYPE_CHECKING:
    from drivers.finding import Adapter, Robot

MODELS = (".urdf", ".xml")


def command(
    host: Annotated[
        list[str] | None, typer.Option("--host", help="Address of a robot; repeatable. No other address is asked then.")
    ] = None,
    network: Annotated[
        list[str] | None, typer.Option(metavar="A.B.C.D/24", help="Ask every address of this network for a robot; repeatable.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the cell; my-ARM if not given.")] = None,
    arm_name: Annotated[
        str | None,
        typer.Option("--arm", metavar="ARM", help="Which arm a robot is, if its controller leaves several possible."),
    ] = None,
    as_json: options.Json = False,
    configs: options.NewConfigs = None,
) -> None:
    """Find robots on the network, CAN adapters, and model files in this folder; write the first cell file.

    A robot is found by its dashboard server (port 29999). Only --host, or a network that you give or agree to, is asked. Nothing
    moves. An existing cell file is never overwritten.

    Example:

        calib init --host 192.168.1.10
    """
    from calib import first_cell
    from calib.excitation.home import open_cell
    from drivers import finding
    from sim.arm import load_arm
    from sim.files import is_name

    if name is not None and not is_name(name):
        raise ConfigError(f"--name {name!r:.80}: a cell's name is 1 to 64 letters, digits, dots, dashes and underscores")
    with console.progress("looking for robots and CAN adapters"):
        found = finding.robots(host) if host else finding.robots(_addresses(network, as_json))
        adapters = [] if host else finding.can_adapters()
    models = [] if host else sorted(f for f in Path().iterdir() if f.suffix in MODELS and f.is_file() and _is_model(f))
    if not as_json:
        _show(found, adapters, models)
    if found:
        robot, arm = _chosen(found, arm_name, as_json)
        cell = name or f"my-{arm}"
        text = first_cell.of_robot(cell, robot, arm)
    elif arm_name is not None and (models or adapters):
        raise ConfigError(
            f"--arm {arm_name}: states which arm a robot is, but none answered; give its address with --host, or leave it out"
        )
    elif models:
        with redirect_stdout(sys.stderr if as_json else sys.stdout):
            arm = _added(models[0], configs)
        loaded = load_arm(arm, configs)
        cell = name or f"my-{arm}"
        plane = open_cell(loaded).table.obstacles[0].position
        text = first_cell.of_mock(cell, loaded, plane[2])
    elif adapters:
        first = adapters[0]
        line = ("servo", "scan", "--interface", first.interface, "--channel", first.channel)
        if not as_json:
            console.say(
                "Which drives are on this bus, and which joint is which? With the arm's name, the scan writes the cell:"
            )
            console.copyable(f"   $ calib {shlex.join(line)} --arm ARM --out configs/cells/my-arm.toml")
        else:
            console.print_json(
                {"schema": "init/1", "robots": [], "adapters": adapters, "models": [], "cell": None, "next": ["calib", *line]}
            )
        return
    else:
        raise AnswerIsNo(
            (f"no robot answered at {', '.join(host)}; check that it is on and that the dashboard server is enabled "
             "(Settings > Security > Services)") if host else
            "nothing was found: no robot, no CAN adapter, no .urdf or .xml model in this folder; give --host ADDRESS, copy a model here, "
            "or try the mock: calib go mock-ur10e --quick"
        )  # fmt: skip
    file = (configs or Path("configs")) / "cells" / f"{cell}.toml"
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        raise ConfigError(f"{file}: exists already and is never overwritten; give another --name, or remove it") from None
    if as_json:
        console.print_json(
            {"schema": "init/1", "robots": found, "adapters": adapters, "models": models, "cell": file, "next": ["calib", "check", cell]}
        )  # fmt: skip
        return
    console.say(f"{file}: written; complete its TODO lines, then:")
    for verb in ("check", "go"):
        console.copyable(f"   $ calib {verb} {cell}")


def _addresses(networks: list[str] | None, as_json: bool) -> list[str]:
    """The addresses to ask: of the given networks, or of this computer's own if the person agrees."""
    from drivers import finding

    chosen = []
    for text in networks or []:
        try:
            network = ipaddress.IPv4Network(text, strict=False)
        except ValueError as error:
            raise ConfigError(f"--network {text}: {error}; write it as 192.168.1.0/24") from error
        if network.num_addresses > finding.MOST_HOSTS or not network.is_private:
            raise ConfigError(
                f"--network {text}: needs a private network of at most {finding.MOST_HOSTS} addresses; give the robot's address with --host"
            )
        chosen.append(network)
    if networks is None and not as_json:
        for network in finding.own_networks():
            question = f"Ask every address of {network} for a robot (port 29999)? This may need the consent of the network's owner. [y/N] "
            if console.ask(question).strip().lower() in ("y", "yes"):
                chosen.append(network)
    return [str(a) for network in chosen for a in (network.hosts() if network.num_addresses > 2 else network)]


def _show(found: list[Robot], adapters: list[Adapter], models: list[Path]) -> None:
    rows = [
        ["robot", r.host, f"{r.model or 'unknown model'}, serial {r.serial or 'not reported'}, PolyScope {r.polyscope}"]
        for r in found
    ]
    rows += [["CAN adapter", a.channel, f"{a.interface}: {a.label}"] for a in adapters]
    rows += [["model file", str(m), m.suffix[1:].upper()] for m in models]
    if rows:
        console.table(["what", "where", "details"], rows)


def _chosen(found: list[Robot], arm: str | None, as_json: bool) -> tuple[Robot, str]:
    """The robot to write a cell for, and its arm; the operator is asked if there are several. ConfigError without a valid answer."""
    robot = found[0]
    if len(found) > 1:
        hosts = [r.host for r in found]
        answer = "" if as_json else console.ask(f"Which robot ({', '.join(hosts)})? ").strip()
        if answer not in hosts:
            raise ConfigError(f"several robots answered: {', '.join(hosts)}; choose one with --host")
        robot = found[hosts.index(answer)]
    if not robot.arms:
        raise ConfigError(
            f"{robot.host}: no arm folder is known for {robot.model or 'a controller that does not report its model'}; make one with "
            "`calib arm new`, then copy configs/cells/emulated-ur10e.toml"
        )
    which = f"the controller reports {robot.model}, which may be {' or '.join(robot.arms)}"
    if len(robot.arms) == 1:
        arm = arm or robot.arms[0]
    elif arm is None and not as_json:
        arm = console.ask(f"{robot.host}: {which}; which one? ").strip()
    if arm not in robot.arms:
        raise ConfigError(f"{robot.host}: {which}{f', not {arm}' if arm else ''}; choose with --arm ARM")
    return robot, arm


def _added(file: Path, configs: Path | None) -> str:
    """The name of the arm of a model file; `calib arm new` creates it if it does not exist yet."""
    from calib.main import start

    name = file.stem
    folder = (configs or Path("configs")) / "arms" / name
    if not folder.is_dir():
        line = ["arm", "new", str(file), "--name", name, "--out", str(folder)]
        console.say("The model file becomes an arm:")
        console.copyable(f"   $ calib {shlex.join(line)}")
        code, sentence = start(line)
        if code:
            raise ConfigError(f"{file}: {sentence}")
    return name


def _is_model(file: Path) -> bool:
    with file.open("rb") as stream:
        head = stream.read(4000)
    return b"<robot" in head or b"<mujoco" in head
