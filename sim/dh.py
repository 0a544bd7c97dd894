"""Denavit-Hartenberg rows of a revolute arm, converted to the pose of each joint's frame in the previous one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DhRows:
    """theta alpha (n,) rad, a d (n,) m: frame k is Rz(q_k + theta_k) Tz(d_k) Tx(a_k) Rx(alpha_k) in frame k - 1."""

    theta: np.ndarray
    a: np.ndarray
    d: np.ndarray
    alpha: np.ndarray


def joint_frames(rows: DhRows, near: np.ndarray) -> np.ndarray:
    """(n, 4, 4) homogeneous: frame of joint k in that of joint k - 1, rotating about its own z.

    Joint k's axis is z of DH frame k - 1, so its frame is Tx(a) Rx(alpha) of row k - 1 and Rz(theta) Tz(d) of row k. The origin
    may lie anywhere on the axis. A calibrated arm has nearly parallel axes whose rows d are many metres and cancel, so each
    origin is moved along its axis to the point nearest to `near` (n, 3) m, its position in the nominal model in the base frame
    at q = 0.
    """
    n = len(rows.d)
    frames = np.empty((n, 4, 4))
    before, world = np.eye(4), np.eye(4)
    for k in range(n):
        axis = world @ before @ _z(rows.theta[k], rows.d[k])
        slide = float((near[k] - axis[:3, 3]) @ axis[:3, 2])
        placed = axis @ _z(0.0, slide)
        frames[k] = np.linalg.solve(world, placed)
        world, before = placed, _z(0.0, -slide) @ _x(rows.alpha[k], rows.a[k])
    return frames


def _z(angle: float, along: float) -> np.ndarray:
    """Rz(angle) Tz(along)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, along], [0, 0, 0, 1.0]])


def _x(angle: float, along: float) -> np.ndarray:
    """Rx(angle) Tx(along)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, along], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
