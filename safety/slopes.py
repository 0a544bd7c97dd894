"""How fast torque can change with angle, speed and acceleration, in any posture and for every parameter set of the box.

With R_il the farthest that the centre of mass of body l can be from joint i (links stretched out), m_l its largest mass and I_l its
largest moment of inertia:
  |M_ij|                       <= B_ij  = sum_l m_l R_il R_jl + I_l
  |dM_ij / dq_k|               <= 2 B_ij
  |c_i|                        <= sum_jk A_ijk |dq_j| |dq_k|,  A_ijk = sum_l m_l R_il R_max(j,k)l + 2 I_l,  |dc_i / dq_k| <= 3 of that
  |dg_i / dq_k|                <= G_ik  = g sum_l m_l R_max(i,k)l
since turning joint k moves what hangs on it by at most its distance, and turns what lies before it along with everything.
"""

from __future__ import annotations

import numpy as np

from safety.parameters import PAYLOAD_DOUBT, SIGMAS
from sim.arm import Arm
from sim.cell import Cell


class Slopes:
    """B (n, n), its part beyond the nominal masses `doubt` (n, n), A (n, n, n) and G (n, n), SI units."""

    def __init__(self, arm: Arm, cell: Cell) -> None:
        n, prior = arm.n, arm.prior
        self.inertia, self.doubt = np.zeros((n, n)), np.zeros((n, n))
        self.coriolis, self.gravity = np.zeros((n, n, n)), np.zeros((n, n))
        pull = float(np.linalg.norm(arm.tree.gravity))
        later = np.maximum.outer(np.arange(n), np.arange(n))
        for link, mass, com, turning, spread, off in _bodies(arm, cell):
            r, chain = distances(arm, link, float(np.linalg.norm(com)) + off)
            heavy, both = mass * (1 + spread), np.outer(chain, chain)
            i_most = turning * (1 + SIGMAS * prior.inertia)
            self.inertia += heavy * np.outer(r, r) + i_most * both
            shift = np.add.outer(r, r) * off * heavy
            self.doubt += mass * spread * np.outer(r, r) + shift + turning * SIGMAS * prior.inertia * both
            self.gravity += heavy * pull * r[later] * both
            all_three = chain[:, None, None] * both[None]
            self.coriolis += (heavy * r[:, None, None] * r[later][None] + 2 * i_most) * all_three
        upright = arm.tree.rotation[0] @ arm.tree.axis[0]
        if not arm.tree.prismatic[0] and pull * np.linalg.norm(np.cross(upright, arm.tree.gravity)) < 1e-9 * pull**2:
            self.gravity[0] = self.gravity[:, 0] = 0.0

    def by_angle(self, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """(C, n, n): bound of |dtau_i / dq_k| for speeds up to dq (C, n) and accelerations up to ddq (C, n)."""
        moving = 2 * ddq @ self.inertia + 3 * np.einsum("ijk,cj,ck->ci", self.coriolis, dq, dq, optimize=True)
        return self.gravity[None] + moving[:, :, None]

    def by_speed(self, dq: np.ndarray, width: np.ndarray) -> np.ndarray:
        """(C, n): bound of the change of torque where speeds up to dq (C, n) change by up to width (C, n)."""
        return 2 * np.einsum("ijk,cj,ck->ci", self.coriolis, dq, width, optimize=True)


def _bodies(arm: Arm, cell: Cell) -> list[tuple[int, float, np.ndarray, float, float, float]]:
    """(link, mass kg, com m, moment of inertia kg m^2, share by which the mass may be larger, m by which the com may be off)."""
    tree, prior = arm.tree, arm.prior
    out = []
    for link, (mass, com, inertia) in enumerate(zip(tree.mass, tree.com, tree.inertia, strict=True)):
        turning = float(np.trace(inertia))
        reach = float(np.linalg.norm(com)) + (float(np.sqrt(max(turning, 0.0) / (2 * mass))) if mass > 0 else 0.0)
        out.append((link, float(mass), com, turning, SIGMAS * prior.mass, SIGMAS * (prior.com + prior.mass) * reach))
    load = cell.table.payload
    if load is not None:
        out.append((arm.n - 1, load.mass, np.array(load.com), 0.0, PAYLOAD_DOUBT, 0.0))
    return out


def distances(arm: Arm, link: int, far: float) -> tuple[np.ndarray, np.ndarray]:
    """R (n,) m that a point `far` m from a link's origin can be from every joint that moves it, and which those are (n,) 0 or 1."""
    tree, r, chain = arm.tree, np.zeros(arm.n), np.zeros(arm.n)
    while link >= 0:
        if tree.prismatic[link]:
            far = max(far + float(max(abs(arm.q_min[link]), abs(arm.q_max[link]))), 1.0)
        r[link], chain[link] = far, 1.0
        far += float(np.linalg.norm(tree.position[link]))
        link = int(tree.parent[link])
    return r, chain
