"""Capsules of an arm's bodies at many postures; maps gradients with respect to their ends or rates to the joints."""

from __future__ import annotations

import numpy as np

from calib.excitation.capsules import beyond_capsules, capsules
from calib.excitation.distances import carried, slopes_by_joints
from sim.arm import Arm
from sim.rigid_body import RigidBody


class MovingCapsules:
    """Capsules of all shapes of an arm, shape after shape.

    names[k]    body that capsule k stands for
    links       (capsules,) link that carries it, -1 for the base
    radius      (capsules,) m
    beyond      (capsules,) m by which the body extends beyond it at most
    on_link     (n, capsules) 1 where that link carries a capsule; a column of zeros for a fixed capsule
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
        # (n, n) 1 where link l is moved by joint j; (n, capsules) which capsules a joint moves
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
        """`segments` from known frames."""
        return np.asarray(carried(self._ends, self.links, rotation, origin))

    def onto_joints(self, pull: np.ndarray, ends: np.ndarray, rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """J^T pull (N, n), gradient with respect to q, from the gradient pull (N, capsules, 2, 3) at the capsules' ends."""
        tree = self.tree
        return np.asarray(slopes_by_joints(pull, ends, rotation, origin, tree.axis, tree.prismatic, self._moves))

    def turning(self, rotation: np.ndarray, dq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axes (N, n, 3) of the joints in the base, zero for prismatic ones; angular velocity (N, n, 3) rad/s of the links."""
        tree = self.tree
        axes = np.stack([rotation[:, j] @ (tree.axis[j] * (not tree.prismatic[j])) for j in range(tree.n)], axis=1)
        return axes, np.einsum("lj,kj,kja->kla", self._moved_by, dq, axes)

    def onto_turning(
        self, pull: np.ndarray, axes: np.ndarray, omega: np.ndarray, dq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradients (N, n) with respect to q and dq, from the gradient pull (N, n) with respect to the links' rates |omega|."""
        force = (pull / np.maximum(np.linalg.norm(omega, axis=-1), 1e-9))[..., None] * omega
        by_q = np.zeros_like(dq)
        for i in range(self.tree.n):
            # a revolute joint before link l rotates the rates that the joints between them add
            later = omega - omega[:, i : i + 1]
            swept = np.cross(axes[:, i : i + 1], later)
            by_q[:, i] = np.einsum("l,kla,kla->k", self._moved_by[:, i], force, swept)
        return by_q, np.einsum("lj,kla,kja->kj", self._moved_by, force, axes)
