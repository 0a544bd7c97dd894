"""The capsules of an arm's bodies at many postures, and what a slope by their ends or their rates is as a slope by the joints."""

from __future__ import annotations

import numpy as np

from calib.excitation.capsules import beyond_capsules, capsules
from calib.excitation.distances import carried, slopes_by_joints
from sim.arm import Arm
from sim.rigid_body import RigidBody


class MovingCapsules:
    """The capsules of all shapes of an arm, shape after shape.

    names[k]    the body that capsule k stands for
    links       (capsules,) the link that carries it, -1 for the base
    radius      (capsules,) m
    beyond      (capsules,) m by which the body reaches beyond it at the most
    on_link     (n, capsules) 1 where a capsule is carried by that link; a column of zeros for what stands still
    """

    def __init__(self, arm: Arm) -> None:
        self.tree = arm.tree
        self._body = RigidBody(arm)
        pieces = [(s, ends, radius) for s in arm.tree.shapes for ends, radius in capsules(s)]
        self.names = [s.name for s, _, _ in pieces]
        self.links = np.array([s.link for s, _, _ in pieces], dtype=np.int64)
        self.radius = np.array([radius for _, _, radius in pieces])
        self.beyond = np.array([beyond_capsules(s) for s, _, _ in pieces])
        self.on_link = (self.links == np.arange(arm.n)[:, None]).astype(float)
        self._ends = np.array([ends for _, ends, _ in pieces]).reshape(-1, 2, 3)
        # 1 where joint j moves link l, (n, n), and which capsules a joint carries, (n, capsules)
        self._moved_by = np.array([arm.tree.moved_by(link) for link in range(arm.n)], dtype=float)
        moves = np.array([arm.tree.moved_by(int(link)) for link in self.links], dtype=bool).reshape(-1, arm.n)
        self._moves = np.ascontiguousarray(moves.T)

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (N, n, 3, 3) and origin (N, n, 3) of every joint frame in the base, q (N, n)."""
        return self._body.frames(q)

    def segments(self, q: np.ndarray) -> np.ndarray:
        """Ends (N, capsules, 2, 3) m of every capsule in the base."""
        return self.segments_at(*self.frames(q))

    def segments_at(self, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """`segments` from frames that are known."""
        return np.asarray(carried(self._ends, self.links, rotation, origin))

    def onto_joints(self, pull: np.ndarray, ends: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Slopes (N, n) by q of a value whose slopes by the ends of the capsules are pull (N, capsules, 2, 3): J^T pull."""
        tree = self.tree
        return np.asarray(slopes_by_joints(pull, ends, rotation, origin, tree.axis, tree.prismatic, self._moves))

    def turning(self, rotation: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axes (N, n, 3) of the hinges in the base, zero for a slide, and angular velocity (N, n, 3) rad/s of every link."""
        tree = self.tree
        axes = np.stack([rotation[:, j] @ (tree.axis[j] * (not tree.prismatic[j])) for j in range(tree.n)], axis=1)
        return axes, np.einsum("lj,kj,kja->kla", self._moved_by, dq, axes)

    def onto_turning(
        self, pull: np.ndarray, axes: np.ndarray, omega: np.ndarray, dq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slopes (N, n) by q and by dq of a value whose slopes by the rates |omega| of the links are pull (N, n)."""
        force = (pull / np.maximum(np.linalg.norm(omega, axis=-1), 1e-9))[..., None] * omega
        by_q = np.zeros_like(dq)
        for i in range(self.tree.n):
            # a hinge before link l turns what the hinges between them add to its rate
            later = omega - omega[:, i : i + 1]
            swept = np.cross(axes[:, i : i + 1], later)
            by_q[:, i] = np.einsum("l,kla,kla->k", self._moved_by[:, i], force, swept)
        return by_q, np.einsum("lj,kla,kja->kj", self._moved_by, force, axes)
