"""The program `calib`: the explicit list of its commands, and the one place where errors become exit codes."""

from __future__ import annotations

import sys
from importlib import import_module

import typer
from rich.console import Console

from sim.errors import CalibError

# name on the command line -> module in calib.commands that has a function `command`
COMMANDS: dict[str, str] = {
    "check": "check",
    "emulate": "emulate",
}

app = typer.Typer(
    name="calib",
    help="Make a simulated robot arm true: excite, record, identify, and name the physical effect that the model lacks.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback()
def _program() -> None:
    """Every command has --help with an example; exit codes: 0 done, 1 the answer is no, 2 usage or data, 3 safety stop, 4 device."""


for _name, _module in COMMANDS.items():
    app.command(_name)(import_module(f"calib.commands.{_module}").command)


def main(arguments: list[str] | None = None) -> int:
    """Run the program; a CalibError is printed as its sentence and becomes its exit code."""
    try:
        result = app(args=arguments, standalone_mode=False)
        return result if isinstance(result, int) else 0
    except CalibError as error:
        Console(stderr=True).print(f"calib: {error}", markup=False, highlight=False, soft_wrap=True)
        return error.exit_code
    except typer.Exit as stop:
        return stop.exit_code
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
