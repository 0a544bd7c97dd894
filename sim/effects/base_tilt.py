"""Gravity whose direction differs from the model's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.motion_view import CandidateColumns, MotionView, of_all_joints
from sim.torque_path import Stage
from sim.tree import KinematicTree

PROBES: tuple[dict[str, float], ...] = ({"roll": 1e-3, "pitch": 0.0}, {"roll": 0.0, "pitch": 1e-3})


class BaseTilt(Effect):
    """gravity in the base frame = R(roll, pitch)^T g, R = R_y(pitch) R_x(roll)."""

    name = "base_tilt"
    summary = "direction of gravity differs from the model's"
    looks = "gravity torque rotated by a constant angle in the world: the first joint shows torque that follows its own angle"
    reference = "MuJoCo manual, option gravity"
    experiment = "slow motion of the first joint over half a turn with the arm outstretched"
    stage = Stage.RIGID
    exact = True
    scope = "arm"
    parameters = (
        Parameter("roll", "rad", "rotation of the base about x", lower=-1.6, upper=1.6, grid=(0.01,)),
        Parameter("pitch", "rad", "then about y", lower=-1.6, upper=1.6, grid=(0.01,)),
    )

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Linear in roll and pitch."""

        def samples(view: MotionView) -> np.ndarray:
            q, zero = view.link.q, np.zeros_like(view.link.q)
            turned = [self.bodies(view.tree, None, point).gravity for point in PROBES]
            moved = [view.bodies.inverse_dynamics(q, zero, zero, gravity - view.tree.gravity) for gravity in turned]
            return np.stack([10.0 * change for change in moved], axis=2)

        columns = [of_all_joints(v, self.name, partial(samples, v)) for v in views]
        yield CandidateColumns(columns, lambda c: {"roll": 0.01 * float(c[0]), "pitch": 0.01 * float(c[1])})

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The tree with gravity rotated."""
        cr, sr, cp, sp = np.cos(p["roll"]), np.sin(p["roll"]), np.cos(p["pitch"]), np.sin(p["pitch"])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        return replace(tree, gravity=(pitch @ roll).T @ tree.gravity)
