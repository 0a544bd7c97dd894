"""`calib help`: the cheat sheet, or the help of one command."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.terminal import console


def _commands(incomplete: str) -> list[str]:
    from calib.main import COMMANDS

    return [name for name in COMMANDS if name.startswith(incomplete)]


def command(
    name: Annotated[
        list[str] | None, typer.Argument(metavar="COMMAND", help="One command in full.", autocompletion=_commands)
    ] = None,
) -> int:
    """Print the cheat sheet: every task and its command on one page; or the help of one command.

    Example:

        calib help plan
    """
    from calib.main import main
    from calib.terminal.cheat_sheet import lines

    if name:
        return main([*name, "--help"])
    for line in lines():
        console.say(line)
    return 0
