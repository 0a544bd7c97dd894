"""The arm that an emulation simulates: with effects unknown to the program under test."""

from __future__ import annotations

from sim.arm import Arm, ArmEffect
from sim.cell import Cell
from sim.effects import with_effect
from sim.errors import ConfigError


def with_hidden_effects(arm: Arm, cell: Cell) -> Arm:
    """`arm` with the effects of the cell's [emulation].

    ConfigError names the cell file if one is unknown, incomplete or out of range.
    """
    for item in cell.table.emulation.effects:
        try:
            arm = with_effect(arm, ArmEffect(item.effect, item.joint, dict(item.parameters)))
        except ConfigError as error:
            raise ConfigError(f"{cell.path}: [emulation]: {error}") from None
    return arm
