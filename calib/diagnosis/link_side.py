"""One measurement up to the load on the gears: the path of the links and the columns of their inertial parameters."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cached_property
from typing import Any

import numpy as np

from calib.preprocessing import Measurement
from sim.arm import Arm
from sim.effects.effect import PathState
from sim.prediction import Stages, link_side
from sim.rigid_body import RigidBody, link_parameters

# of a path, what stages behind the load fill
FILLED = ("q_motor", "dq_motor", "ddq_motor", "level", "width", "warmth", "slip", "tau")


class LinkSide:
    """One measurement up to the load on the gears: path, rigid-body columns, and what was computed from them so far.

    Models whose links move alike share it. paths and columns are caches: torque of one joint with given effects, and candidate columns.
    """

    def __init__(self, measurement: Measurement, arm: Arm, stages: Stages) -> None:
        self.measurement = measurement
        self.path: PathState = link_side(arm, measurement.trajectory, stages, measurement.warming)
        self.bodies = RigidBody(arm)
        self.regressor = self.bodies.regressor(self.path.q, self.path.dq, self.path.ddq)
        self.inertial = _inertial_rows(measurement, arm, self.regressor, self.bodies.parameters())
        self._slopes: dict[int, list[np.ndarray]] = {}
        self.paths: dict[Hashable, Any] = {}
        self.columns: dict[Hashable, np.ndarray] = {}
        self.whites: dict[Hashable, Any] = {}
        self._motion: dict[int, dict[str, np.ndarray]] = {}

    @cached_property
    def largest_load(self) -> np.ndarray:
        """(n,) N m through the gears, exceeded in one sample of a hundred."""
        return np.asarray(np.quantile(np.abs(self.path.load), 0.99, axis=0))

    def joint(self, j: int) -> PathState:
        """The path of joint j alone: the motion shared and read-only, all that later stages change in arrays of its own."""
        if j not in self._motion:
            shared = {k: np.ascontiguousarray(getattr(self.path, k)[:, j : j + 1]) for k in ("q", "dq", "ddq", "load")}
            for x in shared.values():
                x.flags.writeable = False
            self._motion[j] = shared
        motion, path = self._motion[j], self.path
        blank = {k: np.zeros_like(motion["q"]) for k in FILLED}
        own: dict[str, Any] = blank | motion | {"load": motion["load"].copy(), "warmth": np.ones_like(motion["q"])}
        return PathState(
            **own, t=path.t, force=path.force, warming=None if path.warming is None else path.warming[:, j : j + 1]
        )

    def posture_slopes(self, j: int) -> list[np.ndarray]:
        """d tau / d q_j, d tau / d dq_j, d tau / d ddq_j of the bodies, each (N, n), by central differences (tau is quadratic in dq)."""
        if j not in self._slopes:

            def torque(*steps: float) -> np.ndarray:
                moved = [self.path.q.copy(), self.path.dq.copy(), self.path.ddq.copy()]
                for x, step in zip(moved, steps, strict=True):
                    x[:, j] += step
                return self.bodies.inverse_dynamics(*moved)

            by_angle = (torque(1e-3, 0, 0) - torque(-1e-3, 0, 0)) / 2e-3
            by_speed = (torque(0, 1e-2, 0) - torque(0, -1e-2, 0)) / 2e-2
            self._slopes[j] = [by_angle, by_speed, torque(0, 0, 1.0) - torque(0, 0, 0)]
        return self._slopes[j]

    def keep(self, cache: dict[Hashable, Any], key: Hashable, value: Any, most: int) -> Any:
        """Put a value into a cache of at most `most` entries; the oldest goes first."""
        if len(cache) >= most:
            del cache[next(iter(cache))]
        cache[key] = value
        return value


def centre_size(arm: Arm, i: int) -> float:
    """m: the length of which prior.com is a share, for link i."""
    tree = arm.tree
    size = max(float(np.linalg.norm(tree.com[i])), 0.005)
    if arm.prior.numbers in ("guessed", "unknown"):
        size += float(np.sqrt(max(np.trace(tree.inertia[i]), 0.0) / max(tree.mass[i], 1e-9)))
    return size


def _inertial_rows(measurement: Measurement, arm: Arm, regressor: np.ndarray, pi: np.ndarray) -> np.ndarray:
    """(R, n, 5 n) N m per prior standard deviation of m, c and I of every link; a link moves no joint behind it."""
    prior, tree, n = arm.prior, arm.tree, arm.n
    out = np.zeros((len(measurement.row_samples), n, 5 * n))
    for i in range(n):
        block = slice(10 * i, 10 * i + 10)
        size, step = centre_size(arm, i), 1e-6
        moves = [prior.mass * pi[block]]
        for axis in np.eye(3):
            moved = link_parameters(tree.mass[i], tree.com[i] + step * axis, tree.inertia[i])
            moves.append(prior.com * size * (moved - pi[block]) / step)
        moves.append(prior.inertia * link_parameters(0.0, tree.com[i], tree.inertia[i]))
        out[:, : i + 1, 5 * i : 5 * i + 5] = measurement.rows(regressor[:, : i + 1, block] @ np.stack(moves, axis=1))
    return out
