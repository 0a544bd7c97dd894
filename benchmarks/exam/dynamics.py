"""M(q) ddq + h(q, dq) = tau for a chain of hinges, in world coordinates: composite bodies for M, one outward pass for h.

R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 5 and 6. A chain is a tuple of arrays for n joints, joint i moving
link i: rotation (n, 3, 3) and position (n, 3) of joint i's frame in link i-1 at zero, axis (n, 3) in that frame, mass (n) kg,
com (n, 3) m and inertia (n, 3, 3) kg m^2 about the centre of mass, both in the link's frame.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def place(chain, q, turn, origin, z, centre, world_inertia):
    """Frames of all links at q (n,): turn (n, 3, 3), origin (n, 3), axis z, centre of mass (n, 3), inertia about it (n, 3, 3)."""
    rotation, position, axis, _, com, inertia = chain
    n = len(q)
    joint = np.empty((3, 3))
    fixed = np.empty((3, 3))
    for i in range(n):
        s, c = np.sin(q[i]), np.cos(q[i])
        x, y, w = axis[i]
        d = 1.0 - c
        joint[0, 0], joint[0, 1], joint[0, 2] = c + x * x * d, x * y * d - w * s, x * w * d + y * s
        joint[1, 0], joint[1, 1], joint[1, 2] = x * y * d + w * s, c + y * y * d, y * w * d - x * s
        joint[2, 0], joint[2, 1], joint[2, 2] = x * w * d - y * s, y * w * d + x * s, c + w * w * d
        for a in range(3):
            if i == 0:
                origin[i, a] = position[i, a]
                for b in range(3):
                    fixed[a, b] = rotation[i, a, b]
            else:
                origin[i, a] = origin[i - 1, a]
                for b in range(3):
                    origin[i, a] += turn[i - 1, a, b] * position[i, b]
                    fixed[a, b] = 0.0
                    for k in range(3):
                        fixed[a, b] += turn[i - 1, a, k] * rotation[i, k, b]
        for a in range(3):
            for b in range(3):
                turn[i, a, b] = fixed[a, 0] * joint[0, b] + fixed[a, 1] * joint[1, b] + fixed[a, 2] * joint[2, b]
        for a in range(3):
            z[i, a] = turn[i, a, 0] * x + turn[i, a, 1] * y + turn[i, a, 2] * w
            centre[i, a] = origin[i, a] + turn[i, a, 0] * com[i, 0] + turn[i, a, 1] * com[i, 1] + turn[i, a, 2] * com[i, 2]
        for a in range(3):
            for b in range(3):
                fixed[a, b] = 0.0
                for k in range(3):
                    fixed[a, b] += turn[i, a, k] * inertia[i, k, b]
        for a in range(3):
            for b in range(3):
                world_inertia[i, a, b] = fixed[a, 0] * turn[i, b, 0] + fixed[a, 1] * turn[i, b, 1] + fixed[a, 2] * turn[i, b, 2]


@numba.njit(cache=True)
def inertia_matrix(mass, origin, z, centre, world_inertia, out):
    """M (n, n): momentum of everything outward of joint i when joint i alone turns, seen by joint j <= i."""
    n = len(mass)
    total = 0.0
    middle = np.zeros(3)
    about = np.zeros((3, 3))
    arm, sweep, spin, moment = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(n - 1, -1, -1):
        # add link i to the composite body: both inertias move to the common centre
        joined = total + mass[i]
        if joined > 0.0:
            reduced = total * mass[i] / joined
            for a in range(3):
                arm[a] = centre[i, a] - middle[a] if total > 0.0 else 0.0
            square = arm[0] ** 2 + arm[1] ** 2 + arm[2] ** 2
            for a in range(3):
                for b in range(3):
                    about[a, b] += world_inertia[i, a, b] - reduced * arm[a] * arm[b]
                about[a, a] += reduced * square
                middle[a] = (total * middle[a] + mass[i] * centre[i, a]) / joined
        total = joined
        for a in range(3):
            arm[a] = middle[a] - origin[i, a]
            spin[a] = about[a, 0] * z[i, 0] + about[a, 1] * z[i, 1] + about[a, 2] * z[i, 2]
        _cross(z[i], arm, sweep)
        for j in range(i + 1):
            for a in range(3):
                arm[a] = middle[a] - origin[j, a]
            _cross(arm, sweep, moment)
            value = 0.0
            for a in range(3):
                value += z[j, a] * (spin[a] + total * moment[a])
            out[i, j] = out[j, i] = value


@numba.njit(cache=True)
def joint_torque(gravity, force, mass, origin, z, centre, world_inertia, dq, ddq, tau):
    """tau (n,) for ddq at dq under gravity (3,), with `force` (3,) N acting on the last link's origin."""
    n = len(mass)
    omega, alpha, a_origin = np.zeros(3), np.zeros(3), np.empty(3)
    f, m = np.empty((n, 3)), np.empty((n, 3))
    arm, u, w, spin = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for a in range(3):
        a_origin[a] = -gravity[a]
    for i in range(n):
        if i > 0:
            for a in range(3):
                arm[a] = origin[i, a] - origin[i - 1, a]
            _cross(omega, arm, u)
            _cross(omega, u, w)
            _cross(alpha, arm, u)
            for a in range(3):
                a_origin[a] += u[a] + w[a]
        for a in range(3):
            arm[a] = z[i, a] * dq[i]
        _cross(omega, arm, u)
        for a in range(3):
            alpha[a] += z[i, a] * ddq[i] + u[a]
            omega[a] += arm[a]
        for a in range(3):
            arm[a] = centre[i, a] - origin[i, a]
        _cross(omega, arm, u)
        _cross(omega, u, w)
        _cross(alpha, arm, u)
        for a in range(3):
            f[i, a] = mass[i] * (a_origin[a] + u[a] + w[a])
            spin[a] = 0.0
            m[i, a] = 0.0
            for b in range(3):
                spin[a] += world_inertia[i, a, b] * omega[b]
                m[i, a] += world_inertia[i, a, b] * alpha[b]
        _cross(omega, spin, u)
        for a in range(3):
            m[i, a] += u[a]
    push, turn = np.zeros(3), np.zeros(3)  # force, and moment about joint i's origin, of everything outward
    for i in range(n - 1, -1, -1):
        if i < n - 1:
            for a in range(3):
                arm[a] = origin[i + 1, a] - origin[i, a]
            _cross(arm, push, u)
            for a in range(3):
                turn[a] += u[a]
        else:
            for a in range(3):
                push[a] -= force[a]
        for a in range(3):
            arm[a] = centre[i, a] - origin[i, a]
        _cross(arm, f[i], u)
        tau[i] = 0.0
        for a in range(3):
            push[a] += f[i, a]
            turn[a] += m[i, a] + u[a]
            tau[i] += z[i, a] * turn[a]


@numba.njit(cache=True)
def torque_along(chain, gravity, q, dq, ddq):
    """tau (N, n) N m along q dq ddq (N, n)."""
    count, n = q.shape
    turn, inertia = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    origin, z, centre = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    out = np.empty((count, n))
    none = np.zeros(3)
    for k in range(count):
        place(chain, q[k], turn, origin, z, centre, inertia)
        joint_torque(gravity, none, chain[3], origin, z, centre, inertia, dq[k], ddq[k], out[k])
    return out


@numba.njit(cache=True)
def inertia_at(chain, q):
    """M (n, n) kg m^2 at q (n,)."""
    n = len(q)
    turn, inertia = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    origin, z, centre = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    out = np.empty((n, n))
    place(chain, q, turn, origin, z, centre, inertia)
    inertia_matrix(chain[3], origin, z, centre, inertia, out)
    return out


@numba.njit(cache=True)
def solve(matrix, right, out):
    """out (n,) with matrix out = right, matrix (n, n) symmetric positive definite; matrix is overwritten."""
    n = len(right)
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(value) if i == j else value / matrix[j, j]
    for i in range(n):
        value = right[i]
        for k in range(i):
            value -= matrix[i, k] * out[k]
        out[i] = value / matrix[i, i]
    for i in range(n - 1, -1, -1):
        value = out[i]
        for k in range(i + 1, n):
            value -= matrix[k, i] * out[k]
        out[i] = value / matrix[i, i]
