"""Gravity that is not where the model has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.effects.effect import Effect, Parameter, Stage, Values
from sim.tree import KinematicTree


class BaseTilt(Effect):
    """gravity in the base frame = R(roll, pitch)^T g, R = R_y(pitch) R_x(roll)."""

    name = "base_tilt"
    summary = "gravity is not where the model has it"
    looks = "gravity's torque turned by a constant angle in the world: the first joint shows torque that follows its own angle"
    reference = "MuJoCo manual, option gravity"
    experiment = "slow motion of the first joint over half a turn with the arm stretched"
    stage = Stage.RIGID
    scope = "arm"
    parameters = (
        Parameter("roll", "rad", "rotation of the base about x", lower=-1.6, upper=1.6, grid=(0.01,)),
        Parameter("pitch", "rad", "then about y", lower=-1.6, upper=1.6, grid=(0.01,)),
    )

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The tree with gravity turned."""
        cr, sr, cp, sp = np.cos(p["roll"]), np.sin(p["roll"]), np.cos(p["pitch"]), np.sin(p["pitch"])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        return replace(tree, gravity=(pitch @ roll).T @ tree.gravity)
