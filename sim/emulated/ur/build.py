"""The emulated controller of a cell: robot, plant with the cell's hidden effects, and address."""

from __future__ import annotations

import re

import numpy as np
from pydantic import field_validator

from sim.arm import Arm, load_arm
from sim.cell import Cell
from sim.emulated.ur.emulator import UrEmulator
from sim.emulated.ur.primary import held
from sim.emulated.ur.robot import Robot
from sim.errors import ConfigError
from sim.hidden import with_hidden_effects
from sim.plant import Plant
from sim.strict import StrictTable, validated

JOINTS = 6


class UrEmulation(StrictTable):
    """[emulation.options] of a UR cell.

    polyscope: version that the controller reports. remote: whether it starts in remote control. arm: the arm that is really
    there, if it is not the cell's. model: model name that the controller reports, by default from the arm's name. calibration:
    seed of the kinematic calibration that the controller holds.
    """

    polyscope: str = "5.25.1"
    remote: bool = True
    arm: str | None = None
    model: str | None = None
    calibration: int | None = None

    @field_validator("polyscope")
    @classmethod
    def _is_version(cls, text: str) -> str:
        if not re.fullmatch(r"(3|5|10)\.\d+\.\d+", text):
            raise ValueError("must be like 5.25.1, 3.15.4 or 10.11.0")
        return text

    @property
    def version(self) -> tuple[int, int, int]:
        """The version as numbers."""
        major, minor, bugfix = map(int, self.polyscope.split("."))
        return major, minor, bugfix


def emulator(cell: Cell, arm: Arm) -> UrEmulator:
    """The controller of a cell at [options] host, its arm at the cell's home, its plant with the cell's hidden effects."""
    if arm.n != JOINTS:
        raise ConfigError(f"{cell.path}: arm {arm.name} has {arm.n} joints; a UR controller drives {JOINTS}")
    settings = validated(UrEmulation, cell.table.emulation.options, cell.path)
    arm = arm if settings.arm is None else load_arm(settings.arm)
    plant = Plant(with_hidden_effects(arm, cell), drive=arm, seed=cell.table.emulation.seed, obstacles=cell.table.obstacles)
    payload = cell.table.payload
    gravity = arm.gravity
    robot = Robot(
        plant,
        np.array(cell.table.home if cell.table.home is not None else np.zeros(JOINTS)),
        version=settings.version,
        model=settings.model or arm.name.upper().removesuffix("E"),
        torque_constant=arm.torque_constant,
        gravity=(gravity[0], gravity[1], gravity[2]),
        payload=(payload.mass, (payload.com[0], payload.com[1], payload.com[2])) if payload else (0.0, (0.0, 0.0, 0.0)),
    )
    robot.remote = settings.remote
    robot.held = held(arm, settings.calibration)
    # port 80 needs privileges: the Robot API is on if the cell gives it a port, as on a robot where its service is enabled
    port = cell.table.options.get("robot_api_port")
    return UrEmulator(robot, str(cell.table.options.get("host", "")), port if isinstance(port, int) else None)
