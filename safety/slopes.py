"""How fast torque can change with angle, speed and acceleration, in any posture and for every parameter set of the box.

R_i (of body l) is the largest distance of the centre of mass of body l from joint i (links stretched out; at least 1 for a
slide). It falls along the chain. m is the body's largest mass, I its largest moment of inertia. Sums are over the bodies that
all the named joints move:
  |M_ij|          <= B_ij  = sum m R_i R_j + I
  |dM_ij / dq_k|  <= D_ijk = 0 for k <= min(i,j), since everything after k moves as one;
                             sum m (R_min(i,j) + R_k) R_max(i,j) + I for k up to max(i,j), sum m R_k (R_i + R_j) + 2 I beyond
  |c_i|           <= sum_jm A_ijm |dq_j| |dq_m|,  A_ijm = sum m R_i R_max(j,m) + 2 I
  |dc_i / dq_k|   <= sum_jm E_ijmk |dq_j| |dq_m|,  E_ijmk = 0 for k <= min(i,j,m), else
                     sum m (R_max(i,k) R_max(j,m) + [min(j,m) >= k] R_i R_max(j,m) + R_i R_max(j,m,k)) + 6 I
  |dg_i / dq_k|   <= G_ik  = g sum m R_max(i,k), 0 where k turns nothing against gravity
Turning joint k moves a body by R_k per rad and turns what it carries; what comes before it stays.
"""

from __future__ import annotations

import numpy as np

from safety.parameters import PAYLOAD_DOUBT, SIGMAS, reach_of
from sim.arm import Arm
from sim.cell import Cell


class Slopes:
    """In SI units: `doubt` (n, n), the part of B beyond the nominal masses; `inertia` D (n, n, n), `coriolis` A (n, n, n),
    `moving` E (n, n, n, n) and `gravity` G (n, n).
    """

    def __init__(self, arm: Arm, cell: Cell) -> None:
        n, prior = arm.n, arm.prior
        self.doubt, self.inertia = np.zeros((n, n)), np.zeros((n, n, n))
        self.coriolis, self.moving, self.gravity = np.zeros((n, n, n)), np.zeros((n, n, n, n)), np.zeros((n, n))
        pull = float(np.linalg.norm(arm.tree.gravity))
        i, j, m, k = np.ogrid[:n, :n, :n, :n]
        last, first = np.maximum(j, m), np.minimum(j, m)
        steady, one = (k <= np.minimum(i, first)), (k <= np.maximum(i, j))[:, :, 0]
        for link, mass, com, turning, spread, off in _bodies(arm, cell):
            r, chain = distances(arm, link, float(np.linalg.norm(com)) + off)
            heavy, both = mass * (1 + spread), np.outer(chain, chain)
            i_most = turning * (1 + SIGMAS * prior.inertia)
            shift = np.add.outer(r, r) * off * heavy * both
            self.doubt += mass * spread * np.outer(r, r) + shift + turning * SIGMAS * prior.inertia * both
            all_three, all_four = (both[:, :, None] * chain, both[:, :, None, None] * both)
            a, b, c = (x[:, :, 0] for x in (i, j, k))
            within = heavy * (r[np.minimum(a, b)] + r[c]) * r[np.maximum(a, b)] + i_most
            beyond = heavy * r[c] * (r[a] + r[b]) + 2 * i_most
            self.inertia += np.where(c <= np.minimum(a, b), 0.0, np.where(one, within, beyond)) * all_three
            self.coriolis += (heavy * r[a] * r[np.maximum(b, c)] + 2 * i_most) * all_three
            moved = r[np.maximum(i, k)] * r[last] + (first >= k) * r[i] * r[last] + r[i] * r[np.maximum(last, k)]
            self.moving += np.where(steady, 0.0, heavy * moved + 6 * i_most) * all_four
            self.gravity += heavy * pull * r[np.maximum.outer(np.arange(n), np.arange(n))] * both
        self.gravity *= _against_gravity(arm)

    def by_angle(self, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Bound (C, n, n) of |dtau_i / dq_k| for speeds up to dq (C, n) and accelerations up to ddq (C, n)."""
        count, n = dq.shape
        pairs = (dq[:, :, None] * dq[:, None, :]).reshape(count, n * n)
        turned = pairs @ self.moving.transpose(1, 2, 0, 3).reshape(n * n, n * n) + ddq @ self.inertia.transpose(
            1, 0, 2
        ).reshape(n, n * n)
        return self.gravity[None] + turned.reshape(count, n, n)

    def by_speed(self, dq: np.ndarray, width: np.ndarray) -> np.ndarray:
        """Bound (C, n) of the change of torque if speeds up to dq (C, n) change by up to width (C, n)."""
        return 2 * np.einsum("ijk,cj,ck->ci", self.coriolis, dq, width, optimize=True)


def _bodies(arm: Arm, cell: Cell) -> list[tuple[int, float, np.ndarray, float, float, float]]:
    """(link, mass kg, com m, moment of inertia kg m^2, share by which mass may be larger, m by which com may be off)."""
    tree, prior = arm.tree, arm.prior
    out = []
    for link, (mass, com, inertia) in enumerate(zip(tree.mass, tree.com, tree.inertia, strict=True)):
        reach = reach_of(mass, com, inertia)
        out.append(
            (link, float(mass), com, float(np.trace(inertia)), SIGMAS * prior.mass, SIGMAS * (prior.com + prior.mass) * reach)
        )
    load = cell.table.payload
    if load is not None:
        out.append((arm.n - 1, load.mass, np.array(load.com), 0.0, PAYLOAD_DOUBT, 0.0))
    return out


def _against_gravity(arm: Arm) -> np.ndarray:
    """(n, n) of 0 or 1: whether joint k changes the gravity torque at joint i.

    No joint changes it at a vertical axis that nothing tilts, and such an axis changes it at no joint. A slide changes it only
    at joints before it, and its own gravity force is changed only by joints before it.
    """
    tree, n = arm.tree, arm.n
    out, pull = np.ones((n, n)), float(np.linalg.norm(tree.gravity))
    upright: dict[int, np.ndarray] = {
        -1: np.eye(3)
    }  # link that nothing tilts -> its rotation at zero, up to turns about gravity
    for j in range(n):
        before = upright.get(int(tree.parent[j]))
        axis = None if before is None else before @ tree.rotation[j] @ tree.axis[j]
        if tree.prismatic[j]:
            out[j, j:], out[j + 1 :, j] = 0.0, 0.0
        elif axis is not None and np.linalg.norm(np.cross(axis, tree.gravity)) < 1e-9 * pull:
            out[j] = out[:, j] = 0.0
        else:
            continue
        if before is not None:
            upright[j] = before @ tree.rotation[j]
    return out


def distances(arm: Arm, link: int, far: float) -> tuple[np.ndarray, np.ndarray]:
    """R (n,) m: how far a point `far` m from a link's origin can be from each joint that moves it; and those, (n,) 0 or 1."""
    tree, r, chain = arm.tree, np.zeros(arm.n), np.zeros(arm.n)
    while link >= 0:
        if tree.prismatic[link]:
            far = max(far + float(max(abs(arm.q_min[link]), abs(arm.q_max[link]))), 1.0)
        r[link], chain[link] = far, 1.0
        far += float(np.linalg.norm(tree.position[link]))
        link = int(tree.parent[link])
    return r, chain
