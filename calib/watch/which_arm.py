"""The arm that a run belongs to: as in a fleet, arms that differ in model, cell or serial number are different arms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from sim.arm import load_arm
from sim.errors import ConfigError


class WatchedArm(NamedTuple):
    """An arm by its model's name, its cell and its serial numbers; cell and serial are "" where nothing states them."""

    model: str
    cell: str = ""
    serial: str = ""

    @property
    def name(self) -> str:
        """The three with plus signs between."""
        return "+".join(self)


def chosen(arms: Sequence[WatchedArm], word: str | None, table: Path, configs: Path | None = None) -> WatchedArm:
    """The arm of a table that `word` names: by its full name, by its model, or by an arm folder of that model.

    ConfigError where none or several match; without a word the table must hold exactly one.
    """
    names = ", ".join(arm.name for arm in arms) or "no arm"
    meant = [arm for arm in arms if word in (None, arm.name, arm.model)]
    if not meant and word is not None:
        try:
            model = load_arm(word, configs).name
        except ConfigError as error:
            raise ConfigError(f"{table}: has no run of {word!r}, it holds {names}; as an arm: {error}") from error
        meant = [arm for arm in arms if arm.model == model]
        word = model
    if len(meant) == 1:
        return meant[0]
    if not meant:
        raise ConfigError(f"{table}: has no run of {word!r}, it holds {names}" if word else f"{table}: holds no arm")
    several = ", ".join(arm.name for arm in meant)
    raise ConfigError(f"{table}: holds {several} (model+cell+serial); name one: `calib watch MODEL+CELL+SERIAL --trend`")
