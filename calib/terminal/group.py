"""A command with subcommands."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

# `calib.main` takes --quiet out of the words before any command sees them, so no command lists it by itself
QUIET = "--quiet (-q), with every command: print only warnings, errors, and JSON if requested."


class Group(TyperGroup):
    """Prints its help if called without arguments, and lists each subcommand with the whole first paragraph of its help, wrapped."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rest: list[str] = super().parse_args(ctx, args or ["--help"])
        return rest

    def get_command(self, ctx: Any, name: str) -> Any:
        command = super().get_command(ctx, name)
        if command is not None:
            command.epilog = QUIET
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        found = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, " ".join((one.help or "").split("\n\n")[0].split())) for name, one in found if one is not None]
            )
