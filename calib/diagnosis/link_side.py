"""One measurement up to the load on the gears: the path of the links and the columns of their inertial parameters."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from calib.diagnosis.array_cache import ArrayCache
from calib.preprocessing import Measurement
from sim.arm import Arm
from sim.effects.effect import PathState, Values
from sim.effects.friction_law import FrictionLaw
from sim.prediction import Stages, link_side
from sim.rigid_body import RigidBody, link_parameters

# bytes of arrays that are kept for each sample of the recordings
OF_COLUMNS, OF_PATHS, OF_WHITES = 4000.0, 1200.0, 2500.0
FRICTION_LAW = FrictionLaw()
# of a path, what stages behind the load fill
FILLED = ("q_motor", "dq_motor", "ddq_motor", "level", "width", "warmth", "slip", "tau")


class LinkSide:
    """One measurement up to the load on the gears: path, rigid-body columns, and what was computed from them so far.

    Models whose links move alike share it. paths: joints with given effects; kept: candidate columns and what they are made of.
    """

    def __init__(self, measurement: Measurement, arm: Arm, stages: Stages) -> None:
        self.measurement = measurement
        self.path: PathState = link_side(arm, measurement.trajectory, stages, measurement.warming)
        self.bodies = RigidBody(arm)
        self.inertial = _inertial_rows(measurement, arm, self.regressor, self.bodies.parameters())
        self.kept = ArrayCache(OF_COLUMNS * len(self.path.t))
        self.paths = ArrayCache(OF_PATHS * len(self.path.t))
        self._whites: ArrayCache | None = None
        self._motion: dict[int, dict[str, np.ndarray]] = {}

    def whites(self, samples: int) -> ArrayCache:
        """Whitened rows of all recordings, of which this is the first, with so many samples together."""
        self._whites = self._whites or ArrayCache(OF_WHITES * samples)
        return self._whites

    @property
    def regressor(self) -> np.ndarray:
        """(N, n, 10 n) of the links; as large as all recordings together, so nobody keeps it."""
        return self.bodies.regressor(self.path.q, self.path.dq, self.path.ddq)

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

    def law(self, j: int, p: Values) -> np.ndarray:
        """(N, 1) N m of a friction law of joint j on the motion and the load of the links."""

        def torque() -> np.ndarray:
            state = self.joint(j)
            state.q_motor[:], state.dq_motor[:] = state.q, state.dq
            FRICTION_LAW.apply(state, 0, p)
            return state.tau

        found: np.ndarray = self.kept.of(("law", j, tuple(p.values())), torque)
        return found

    def posture_slopes(self, j: int) -> np.ndarray:
        """(3, N, n) d tau / d q_j, d tau / d dq_j, d tau / d ddq_j of the bodies, by central differences (tau is quadratic in dq)."""
        found: np.ndarray = self.kept.of(("posture", j), lambda: self._posture_slopes(j))
        return found

    def _posture_slopes(self, j: int) -> np.ndarray:

        def torque(*steps: float) -> np.ndarray:
            moved = [self.path.q.copy(), self.path.dq.copy(), self.path.ddq.copy()]
            for x, step in zip(moved, steps, strict=True):
                x[:, j] += step
            return self.bodies.inverse_dynamics(*moved)

        by_angle = (torque(1e-3, 0, 0) - torque(-1e-3, 0, 0)) / 2e-3
        by_speed = (torque(0, 1e-2, 0) - torque(0, -1e-2, 0)) / 2e-2
        return np.stack([by_angle, by_speed, torque(0, 0, 1.0) - torque(0, 0, 0)])


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
