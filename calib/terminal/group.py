"""A command with subcommands."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup


class Group(TyperGroup):
    """Prints its help if called without arguments, and lists each subcommand with the whole first paragraph of its help, wrapped."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rest: list[str] = super().parse_args(ctx, args or ["--help"])
        return rest

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        found = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, " ".join((one.help or "").split("\n\n")[0].split())) for name, one in found if one is not None]
            )
