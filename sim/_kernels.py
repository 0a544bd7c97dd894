"""Newton-Euler recursions over many samples at once, compiled by Numba; called only by `sim.rigid_body`.

Link i's quantities stand in its own joint frame. Source of the recursion and of the regressor's form: R. Featherstone, Rigid Body
Dynamics Algorithms (2008), chapters 5.3 and 9.6 (inertial parameters enter linearly); checked against Pinocchio in the tests.
"""

from __future__ import annotations

import numba
import numpy as np

# a product and a sum may become one instruction; nothing is reordered
CONTRACT = {"contract"}


@numba.njit(cache=True)
def _joint_rotation(axis: np.ndarray, angle: float, out: np.ndarray) -> None:
    """Rodrigues' formula R(axis, angle)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    k = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + x * x * k, x * y * k - z * s, x * z * k + y * s
    out[1, 0], out[1, 1], out[1, 2] = y * x * k + z * s, c + y * y * k, y * z * k - x * s
    out[2, 0], out[2, 1], out[2, 2] = z * x * k - y * s, z * y * k + x * s, c + z * z * k


@numba.njit(cache=True)
def _cross(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def _to_child(r: np.ndarray, v: np.ndarray, out: np.ndarray) -> None:
    """out = R^T v."""
    for k in range(3):
        out[k] = r[0, k] * v[0] + r[1, k] * v[1] + r[2, k] * v[2]


@numba.njit(cache=True, fastmath=CONTRACT)
def _turns(rotation, axis):  # type: ignore[no-untyped-def]
    """A, B, C (n, 3, 3, 3) with rotation R(axis, angle) = A + cos(angle) B + sin(angle) C: Rodrigues' formula, what is constant in it."""
    n = len(axis)
    out = np.zeros((n, 3, 3, 3))
    cross = np.zeros((3, 3))
    for i in range(n):
        x, y, z = axis[i, 0], axis[i, 1], axis[i, 2]
        cross[0, 1], cross[0, 2], cross[1, 2] = -z, y, -x
        cross[1, 0], cross[2, 0], cross[2, 1] = z, -y, x
        for c in range(3):
            for d in range(3):
                for e in range(3):
                    along = axis[i, e] * axis[i, d]
                    out[i, 0, c, d] += rotation[i, c, e] * along
                    out[i, 1, c, d] += rotation[i, c, e] * ((1.0 if e == d else 0.0) - along)
                    out[i, 2, c, d] += rotation[i, c, e] * cross[e, d]
    return out


@numba.njit(cache=True, fastmath=CONTRACT)
def _forward(parent, rotation, turns, position, axis, prismatic, gravity, q, dq, ddq, w, dw, a, sw, sv, chain):  # type: ignore[no-untyped-def]
    """One sample: angular velocity w, its rate dw, acceleration a of the frame's origin less gravity, and for every joint j that
    moves link i its unit twist (sw[i, j], sv[i, j]) at link i's origin; all in link i's axes. chain[i, j] marks j as such a joint."""
    n = len(parent)
    r = np.empty((3, 3))
    p, t1, t2, t3 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    zero = np.zeros(3)
    for i in range(n):
        up = parent[i]
        if prismatic[i]:
            for c in range(3):
                p[c] = position[i, c]
                for d in range(3):
                    r[c, d] = rotation[i, c, d]
            for c in range(3):
                p[c] += (r[c, 0] * axis[i, 0] + r[c, 1] * axis[i, 1] + r[c, 2] * axis[i, 2]) * q[i]
        else:
            cosine, sine = np.cos(q[i]), np.sin(q[i])
            for c in range(3):
                p[c] = position[i, c]
                for d in range(3):
                    r[c, d] = turns[i, 0, c, d] + cosine * turns[i, 1, c, d] + sine * turns[i, 2, c, d]
        if up < 0:
            wp, dwp = zero, zero
            for c in range(3):
                t3[c] = -gravity[c]
        else:
            wp, dwp = w[up], dw[up]
            _cross(dwp, p, t1)
            _cross(wp, p, t2)
            _cross(wp, t2, t3)
            for c in range(3):
                t3[c] += t1[c] + a[up, c]
        _to_child(r, wp, w[i])
        _to_child(r, dwp, dw[i])
        _to_child(r, t3, a[i])
        if prismatic[i]:
            _cross(w[i], axis[i], t1)
            for c in range(3):
                a[i, c] += axis[i, c] * ddq[i] + 2.0 * t1[c] * dq[i]
        else:
            _cross(w[i], axis[i], t1)
            for c in range(3):
                dw[i, c] += axis[i, c] * ddq[i] + t1[c] * dq[i]
                w[i, c] += axis[i, c] * dq[i]
        for j in range(i):
            if chain[i, j]:
                _cross(sw[up, j], p, t1)
                for c in range(3):
                    t1[c] += sv[up, j, c]
                _to_child(r, sw[up, j], sw[i, j])
                _to_child(r, t1, sv[i, j])
        for c in range(3):
            sw[i, i, c] = 0.0 if prismatic[i] else axis[i, c]
            sv[i, i, c] = axis[i, c] if prismatic[i] else 0.0


@numba.njit(cache=True, fastmath=CONTRACT)
def regressor(parent, rotation, position, axis, prismatic, chain, gravity, q, dq, ddq, out):  # type: ignore[no-untyped-def]
    """out (N, n, 10 n), zeroed by the caller: tau = out @ pi."""
    n = len(parent)
    w, dw, a = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    sw, sv = np.zeros((n, n, 3)), np.zeros((n, n, 3))
    turns = _turns(rotation, axis)
    for k in range(len(q)):
        _forward(parent, rotation, turns, position, axis, prismatic, gravity, q[k], dq[k], ddq[k], w, dw, a, sw, sv, chain)
        for i in range(n):
            wx, wy, wz = w[i, 0], w[i, 1], w[i, 2]
            ax, ay, az = a[i, 0], a[i, 1], a[i, 2]
            ex, ey, ez = dw[i, 0], dw[i, 1], dw[i, 2]
            xx, yy, zz, xy, xz, yz = wx * wx, wy * wy, wz * wz, wx * wy, wx * wz, wy * wz
            for j in range(i + 1):
                if not chain[i, j]:
                    continue
                vx, vy, vz = sv[i, j, 0], sv[i, j, 1], sv[i, j, 2]
                ux, uy, uz = sw[i, j, 0], sw[i, j, 1], sw[i, j, 2]
                y = out[k, j, 10 * i : 10 * i + 10]
                y[0] = vx * ax + vy * ay + vz * az
                y[1] = -vx * (yy + zz) + vy * (xy + ez) + vz * (xz - ey) + uz * ay - uy * az
                y[2] = vx * (xy - ez) - vy * (xx + zz) + vz * (yz + ex) + ux * az - uz * ax
                y[3] = vx * (xz + ey) + vy * (yz - ex) - vz * (xx + yy) + uy * ax - ux * ay
                y[4] = ux * ex + uy * xz - uz * xy
                y[5] = ux * (ey - xz) + uy * (ex + yz) + uz * (xx - yy)
                y[6] = uy * ey - ux * yz + uz * xy
                y[7] = ux * (ez + xy) + uy * (zz - xx) + uz * (ex - yz)
                y[8] = ux * (yy - zz) + uy * (ez - xy) + uz * (ey + xz)
                y[9] = uz * ez + ux * yz - uy * xz


@numba.njit(cache=True, fastmath=CONTRACT)
def torque(parent, rotation, position, axis, prismatic, chain, gravity, mass, first, inertia, q, dq, ddq, out):  # type: ignore[no-untyped-def]
    """out (N, n): inverse dynamics; first (n, 3) = m c, inertia (n, 3, 3) about the frame's origin; gravity (3,)."""
    n = len(parent)
    w, dw, a = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    sw, sv = np.zeros((n, n, 3)), np.zeros((n, n, 3))
    t, f, m, h = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    turns = _turns(rotation, axis)
    for k in range(len(q)):
        _forward(parent, rotation, turns, position, axis, prismatic, gravity, q[k], dq[k], ddq[k], w, dw, a, sw, sv, chain)
        for j in range(n):
            out[k, j] = 0.0
        for i in range(n):
            _cross(w[i], first[i], t)
            _cross(w[i], t, f)
            _cross(dw[i], first[i], t)
            for c in range(3):
                f[c] += t[c] + mass[i] * a[i, c]
                h[c] = inertia[i, c, 0] * w[i, 0] + inertia[i, c, 1] * w[i, 1] + inertia[i, c, 2] * w[i, 2]
            _cross(w[i], h, m)
            _cross(first[i], a[i], t)
            for c in range(3):
                m[c] += t[c] + inertia[i, c, 0] * dw[i, 0] + inertia[i, c, 1] * dw[i, 1] + inertia[i, c, 2] * dw[i, 2]
            for j in range(i + 1):
                if chain[i, j]:
                    for c in range(3):
                        out[k, j] += sv[i, j, c] * f[c] + sw[i, j, c] * m[c]


@numba.njit(cache=True)
def jacobian(parent, rotation, position, axis, prismatic, chain, link, point, q, linear, angular):  # type: ignore[no-untyped-def]
    """linear and angular (N, 3, n): velocity of `point` (3,), fixed in `link`, per unit joint rate, in the base's axes."""
    n = len(parent)
    world_r, world_p = np.empty((n, 3, 3)), np.empty((n, 3))
    joint, local = np.empty((3, 3)), np.empty((3, 3))
    arm, velocity = np.empty(3), np.empty(3)
    for k in range(len(q)):
        for i in range(n):
            slide = q[k, i] if prismatic[i] else 0.0
            _joint_rotation(axis[i], 0.0 if prismatic[i] else q[k, i], joint)
            local[:] = rotation[i] @ joint
            p = position[i] + local @ axis[i] * slide
            if parent[i] < 0:
                world_r[i] = local
                world_p[i] = p
            else:
                world_r[i] = world_r[parent[i]] @ local
                world_p[i] = world_p[parent[i]] + world_r[parent[i]] @ p
        target = world_p[link] + world_r[link] @ point
        for j in range(n):
            if not chain[link, j]:
                continue
            z = world_r[j] @ axis[j]
            if prismatic[j]:
                for c in range(3):
                    linear[k, c, j] = z[c]
                    angular[k, c, j] = 0.0
            else:
                for c in range(3):
                    arm[c] = target[c] - world_p[j, c]
                _cross(z, arm, velocity)
                for c in range(3):
                    linear[k, c, j] = velocity[c]
                    angular[k, c, j] = z[c]
