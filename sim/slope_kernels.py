"""Derivatives of a weighted sum over the regressor with respect to the motion, compiled, for the search for motions.

  f = sum_jp Y_jp w_jp = sum_ij u_ij . wrench(w_j of link i, motion of link i), u_ij the unit twist of joint j at link i.

They are exact: one sweep out over the recursion of `sim.recursion_kernels` and one back (reverse accumulation: A. Griewank, A.
Walther, Evaluating Derivatives, 2008, chapter 3). Each link's quantities are expressed in its own frame. A turn of the joint by
dq changes a vector v from the link before by -dq (axis x v).
"""

from __future__ import annotations

import numba
import numpy as np

from sim.recursion_kernels import CONTRACT, LANES, forward, joint_turns, workspace


@numba.njit(cache=True, fastmath=CONTRACT)
def _by_link(own, count, motion, unit, by_motion, by_unit):  # type: ignore[no-untyped-def]
    """Add the derivatives of unit . wrench(own, motion) to by_motion (9, LANES) and by_unit (6, LANES).

    own (10, count): parameters of a link.
    """
    for s in range(count):
        m, hx, hy, hz = own[0, s], own[1, s], own[2, s], own[3, s]
        xx, xy, yy, xz, yz, zz = own[4, s], own[5, s], own[6, s], own[7, s], own[8, s], own[9, s]
        wx, wy, wz = motion[0, s], motion[1, s], motion[2, s]
        ex, ey, ez = motion[3, s], motion[4, s], motion[5, s]
        ax, ay, az = motion[6, s], motion[7, s], motion[8, s]
        ux, uy, uz, vx, vy, vz = unit[0, s], unit[1, s], unit[2, s], unit[3, s], unit[4, s], unit[5, s]
        tx, ty, tz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
        lx, ly, lz = xx * wx + xy * wy + xz * wz, xy * wx + yy * wy + yz * wz, xz * wx + yz * wy + zz * wz
        by_unit[0, s] += xx * ex + xy * ey + xz * ez + wy * lz - wz * ly + hy * az - hz * ay
        by_unit[1, s] += xy * ex + yy * ey + yz * ez + wz * lx - wx * lz + hz * ax - hx * az
        by_unit[2, s] += xz * ex + yz * ey + zz * ez + wx * ly - wy * lx + hx * ay - hy * ax
        by_unit[3, s] += m * ax + ey * hz - ez * hy + wy * tz - wz * ty
        by_unit[4, s] += m * ay + ez * hx - ex * hz + wz * tx - wx * tz
        by_unit[5, s] += m * az + ex * hy - ey * hx + wx * ty - wy * tx
        # u . (w x I w) = (u x w) . I w, and v . (w x (w x h)) = (v . w)(w . h) - (w . w)(v . h)
        bx, by, bz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        along, spin, reach = vx * wx + vy * wy + vz * wz, wx * hx + wy * hy + wz * hz, 2.0 * (vx * hx + vy * hy + vz * hz)
        by_motion[0, s] += ly * uz - lz * uy + xx * bx + xy * by + xz * bz + vx * spin + hx * along - reach * wx
        by_motion[1, s] += lz * ux - lx * uz + xy * bx + yy * by + yz * bz + vy * spin + hy * along - reach * wy
        by_motion[2, s] += lx * uy - ly * ux + xz * bx + yz * by + zz * bz + vz * spin + hz * along - reach * wz
        by_motion[3, s] += xx * ux + xy * uy + xz * uz + hy * vz - hz * vy
        by_motion[4, s] += xy * ux + yy * uy + yz * uz + hz * vx - hx * vz
        by_motion[5, s] += xz * ux + yz * uy + zz * uz + hx * vy - hy * vx
        by_motion[6, s] += m * vx + uy * hz - uz * hy
        by_motion[7, s] += m * vy + uz * hx - ux * hz
        by_motion[8, s] += m * vz + ux * hy - uy * hx


@numba.njit(cache=True, fastmath=CONTRACT)
def _onto_joint(axis, slide, count, motion, by_motion, rate, by_q, by_rate, by_push):  # type: ignore[no-untyped-def]
    """Derivatives by a joint's rate, acceleration and, for a hinge, angle; by_motion becomes that by r, e_0 and a_0.

    w = r + z dq, e = e_0 + z ddq + dq r x z for a hinge; a = a_0 + z ddq + 2 dq r x z for a slide. r, e_0 and a_0 come from the
    link before, rotated.
    """
    x, y, z = axis[0], axis[1], axis[2]
    for s in range(count):
        wx, wy, wz = motion[0, s], motion[1, s], motion[2, s]
        cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        if slide:
            px, py, pz, dq = by_motion[6, s], by_motion[7, s], by_motion[8, s], 2.0 * rate[s]
            by_rate[s] += 2.0 * (cx * px + cy * py + cz * pz)
        else:
            px, py, pz, dq = by_motion[3, s], by_motion[4, s], by_motion[5, s], rate[s]
            by_rate[s] += cx * px + cy * py + cz * pz + x * by_motion[0, s] + y * by_motion[1, s] + z * by_motion[2, s]
        by_push[s] += x * px + y * py + z * pz
        by_motion[0, s] += dq * (y * pz - z * py)
        by_motion[1, s] += dq * (z * px - x * pz)
        by_motion[2, s] += dq * (x * py - y * px)
        if not slide:
            ex, ey, ez = motion[3, s] - dq * cx, motion[4, s] - dq * cy, motion[5, s] - dq * cz
            ax, ay, az = motion[6, s], motion[7, s], motion[8, s]
            fx, fy, fz = by_motion[0, s], by_motion[1, s], by_motion[2, s]
            gx, gy, gz = by_motion[6, s], by_motion[7, s], by_motion[8, s]
            turned = x * (wy * fz - wz * fy + ey * pz - ez * py + ay * gz - az * gy)
            turned += y * (wz * fx - wx * fz + ez * px - ex * pz + az * gx - ax * gz)
            turned += z * (wx * fy - wy * fx + ex * py - ey * px + ax * gy - ay * gx)
            by_q[s] -= turned


@numba.njit(cache=True, fastmath=CONTRACT)
def _placed(turns, rotation, position, axis, slide, count, q, local):  # type: ignore[no-untyped-def]
    """local (12, LANES): position and rotation, row by row, of a link's frame in that of the link before."""
    for c in range(3):
        along = (rotation[c, 0] * axis[0] + rotation[c, 1] * axis[1] + rotation[c, 2] * axis[2]) * slide
        for s in range(count):
            local[c, s] = position[c] + along * q[s]
    for s in range(count):
        cos, sin = (1.0, 0.0) if slide else (np.cos(q[s]), np.sin(q[s]))
        for c in range(3):
            for d in range(3):
                local[3 + 3 * c + d, s] = turns[0, c, d] + cos * turns[1, c, d] + sin * turns[2, c, d]


@numba.njit(cache=True, fastmath=CONTRACT)
def _onto_before(local, count, up, by_motion, by_up, by_place):  # type: ignore[no-untyped-def]
    """Derivatives by the motion `up` of the link before, from those by r, e_0 and a_0.

    a_0 = R^T (a + e x p + w x (w x p)). by_place (3, LANES): by the position p, in the axes of the link before.
    """
    for s in range(count):
        px, py, pz = local[0, s], local[1, s], local[2, s]
        wx, wy, wz, ex, ey, ez = up[0, s], up[1, s], up[2, s], up[3, s], up[4, s], up[5, s]
        fx, fy, fz = by_motion[6, s], by_motion[7, s], by_motion[8, s]
        gx = local[3, s] * fx + local[4, s] * fy + local[5, s] * fz
        gy = local[6, s] * fx + local[7, s] * fy + local[8, s] * fz
        gz = local[9, s] * fx + local[10, s] * fy + local[11, s] * fz
        by_up[6, s] += gx
        by_up[7, s] += gy
        by_up[8, s] += gz
        fx, fy, fz = by_motion[3, s], by_motion[4, s], by_motion[5, s]
        by_up[3, s] += local[3, s] * fx + local[4, s] * fy + local[5, s] * fz + py * gz - pz * gy
        by_up[4, s] += local[6, s] * fx + local[7, s] * fy + local[8, s] * fz + pz * gx - px * gz
        by_up[5, s] += local[9, s] * fx + local[10, s] * fy + local[11, s] * fz + px * gy - py * gx
        fx, fy, fz = by_motion[0, s], by_motion[1, s], by_motion[2, s]
        reach, along, spin = 2.0 * (px * gx + py * gy + pz * gz), wx * px + wy * py + wz * pz, wx * gx + wy * gy + wz * gz
        by_up[0, s] += local[3, s] * fx + local[4, s] * fy + local[5, s] * fz + gx * along + px * spin - reach * wx
        by_up[1, s] += local[6, s] * fx + local[7, s] * fy + local[8, s] * fz + gy * along + py * spin - reach * wy
        by_up[2, s] += local[9, s] * fx + local[10, s] * fy + local[11, s] * fz + gz * along + pz * spin - reach * wz
        square = wx * wx + wy * wy + wz * wz
        by_place[0, s] += gy * ez - gz * ey + spin * wx - square * gx
        by_place[1, s] += gz * ex - gx * ez + spin * wy - square * gy
        by_place[2, s] += gx * ey - gy * ex + spin * wz - square * gz


@numba.njit(cache=True, fastmath=CONTRACT)
def _twist_onto_before(axis, slide, local, count, now, before, by_now, by_before, by_q, by_place):  # type: ignore[no-untyped-def]
    """The same for a unit twist that the link passes on, now = R^T (u, v + u x p), and its derivative by the joint's angle."""
    x, y, z = axis[0], axis[1], axis[2]
    for s in range(count):
        px, py, pz = local[0, s], local[1, s], local[2, s]
        ux, uy, uz = before[0, s], before[1, s], before[2, s]
        fx, fy, fz = by_now[3, s], by_now[4, s], by_now[5, s]
        if not slide:
            ax, ay, az, bx, by, bz = now[0, s], now[1, s], now[2, s], now[3, s], now[4, s], now[5, s]
            gx, gy, gz = by_now[0, s], by_now[1, s], by_now[2, s]
            turned = x * (ay * gz - az * gy + by * fz - bz * fy)
            turned += y * (az * gx - ax * gz + bz * fx - bx * fz)
            turned += z * (ax * gy - ay * gx + bx * fy - by * fx)
            by_q[s] -= turned
        gx = local[3, s] * fx + local[4, s] * fy + local[5, s] * fz
        gy = local[6, s] * fx + local[7, s] * fy + local[8, s] * fz
        gz = local[9, s] * fx + local[10, s] * fy + local[11, s] * fz
        by_before[3, s] += gx
        by_before[4, s] += gy
        by_before[5, s] += gz
        by_place[0, s] += gy * uz - gz * uy
        by_place[1, s] += gz * ux - gx * uz
        by_place[2, s] += gx * uy - gy * ux
        fx, fy, fz = by_now[0, s], by_now[1, s], by_now[2, s]
        by_before[0, s] += local[3, s] * fx + local[4, s] * fy + local[5, s] * fz + py * gz - pz * gy
        by_before[1, s] += local[6, s] * fx + local[7, s] * fy + local[8, s] * fz + pz * gx - px * gz
        by_before[2, s] += local[9, s] * fx + local[10, s] * fy + local[11, s] * fz + px * gy - py * gx


@numba.njit(cache=True, fastmath=CONTRACT)
def slopes(parent, rotation, position, axis, prismatic, chain, gravity, q, dq, ddq, weights, by_q, by_dq, by_ddq):  # type: ignore[no-untyped-def]
    """Derivatives (n, N) of f by q, dq and ddq (N, n), zeroed by the caller; weights (n, n, 10, N), joint and link first."""
    n, turns = len(parent), joint_turns(rotation, axis)
    work, local = workspace(axis, prismatic, gravity), np.empty((12, LANES))
    motion, twist = work[0], work[1]
    by_motion, by_twist, by_place = np.empty(motion.shape), np.empty(twist.shape), np.empty((3, LANES))
    place, rate = np.empty(LANES), np.empty(LANES)
    for first in range(0, len(q), LANES):
        count = min(LANES, len(q) - first)
        part = slice(first, first + count)
        forward(parent, rotation, turns, position, axis, prismatic, chain, q[part], dq[part], ddq[part], work)
        by_motion[:], by_twist[:] = 0.0, 0.0
        for i in range(n - 1, -1, -1):
            for j in range(i + 1):
                if chain[i, j]:
                    _by_link(weights[j, i, :, part], count, motion[i], twist[i, j], by_motion[i], by_twist[i, j])
            for s in range(count):
                place[s], rate[s] = q[first + s, i], dq[first + s, i]
            slide = prismatic[i]
            _placed(turns[i], rotation[i], position[i], axis[i], slide, count, place, local)
            _onto_joint(axis[i], slide, count, motion[i], by_motion[i], rate, by_q[i, part], by_dq[i, part], by_ddq[i, part])
            up = parent[i]
            by_place[:] = 0.0
            _onto_before(local, count, motion[up], by_motion[i], by_motion[up], by_place)
            for j in range(i):
                if chain[i, j]:
                    _twist_onto_before(
                        axis[i], slide, local, count, twist[i, j], twist[up, j], by_twist[i, j], by_twist[up, j], by_q[i, part], by_place
                    )  # fmt: skip
            if slide:
                for c in range(3):
                    along = rotation[i, c, 0] * axis[i, 0] + rotation[i, c, 1] * axis[i, 1] + rotation[i, c, 2] * axis[i, 2]
                    for s in range(count):
                        by_q[i, first + s] += along * by_place[c, s]
