"""Newton-Euler recursions over many samples at once, compiled by Numba; called only by `sim.rigid_body`.

Quantities of link i are expressed in its own joint frame. Source of the recursion and of the regressor's form: R. Featherstone,
Rigid Body Dynamics Algorithms (2008), chapters 5.3 and 9.6 (inertial parameters enter linearly); checked against Pinocchio in
the tests.

Samples are processed in blocks of LANES; each number of the recursion is a row of that length. What is the same for all samples
is read once per block, and the compiler vectorises the inner loops.
"""

from __future__ import annotations

import numba
import numpy as np

from sim.first_use import listen

listen()
# a product and a sum may become one instruction; nothing is reordered
CONTRACT = {"contract"}
LANES = 32


@numba.njit(cache=True, fastmath=CONTRACT)
def joint_turns(rotation, axis):  # type: ignore[no-untyped-def]
    """A, B, C (n, 3, 3, 3) with rotation R(axis, angle) = A + cos(angle) B + sin(angle) C, from Rodrigues' formula."""
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
def workspace(axis, prismatic, gravity):  # type: ignore[no-untyped-def]
    """Buffers of `forward`: motion (n + 1, 9, LANES) with the base last, unit twists (n, n, 6, LANES), two scratch arrays."""
    n = len(axis)
    motion, twist = np.zeros((n + 1, 9, LANES)), np.zeros((n, n, 6, LANES))
    for c in range(3):
        motion[n, 6 + c] = -gravity[c]
        for i in range(n):
            twist[i, i, 3 * prismatic[i] + c] = axis[i, c]
    return motion, twist, np.empty((5, LANES)), np.empty((12, LANES))


@numba.njit(cache=True, fastmath=CONTRACT)
def forward(parent, rotation, turns, position, axis, prismatic, chain, q, dq, ddq, work):  # type: ignore[no-untyped-def]
    """Forward recursion for up to LANES samples, q dq ddq (count, n).

    motion[i]: angular velocity, its rate, and the acceleration of link i's origin minus gravity. twist[i, j]: what a unit rate
    of joint j adds to the velocity of link i, angular then linear; chain[i, j] marks the joints j that move link i.
    """
    motion, twist, joint, local = work
    count = len(q)
    for i in range(len(parent)):
        x, y, z = axis[i, 0], axis[i, 1], axis[i, 2]
        slide = 1.0 if prismatic[i] else 0.0
        hinge = 1.0 - slide
        for s in range(count):
            joint[0, s], joint[1, s] = np.cos(hinge * q[s, i]), np.sin(hinge * q[s, i])
            joint[2, s], joint[3, s], joint[4, s] = slide * q[s, i], dq[s, i], ddq[s, i]
        for c in range(3):
            along = rotation[i, c, 0] * x + rotation[i, c, 1] * y + rotation[i, c, 2] * z
            for s in range(count):
                local[c, s] = position[i, c] + along * joint[2, s]
            for d in range(3):
                fixed, even, odd = turns[i, 0, c, d], turns[i, 1, c, d], turns[i, 2, c, d]
                for s in range(count):
                    local[3 + 3 * c + d, s] = fixed + joint[0, s] * even + joint[1, s] * odd
        up, own = motion[parent[i]], motion[i]
        for s in range(count):
            px, py, pz = local[0, s], local[1, s], local[2, s]
            wx, wy, wz, ex, ey, ez = up[0, s], up[1, s], up[2, s], up[3, s], up[4, s], up[5, s]
            vx, vy, vz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
            ax = up[6, s] + ey * pz - ez * py + wy * vz - wz * vy
            ay = up[7, s] + ez * px - ex * pz + wz * vx - wx * vz
            az = up[8, s] + ex * py - ey * px + wx * vy - wy * vx
            rx = local[3, s] * wx + local[6, s] * wy + local[9, s] * wz
            ry = local[4, s] * wx + local[7, s] * wy + local[10, s] * wz
            rz = local[5, s] * wx + local[8, s] * wy + local[11, s] * wz
            rate, push = joint[3, s], joint[4, s]
            cx, cy, cz = rate * (ry * z - rz * y), rate * (rz * x - rx * z), rate * (rx * y - ry * x)
            own[0, s] = rx + hinge * x * rate
            own[1, s] = ry + hinge * y * rate
            own[2, s] = rz + hinge * z * rate
            own[3, s] = local[3, s] * ex + local[6, s] * ey + local[9, s] * ez + hinge * (x * push + cx)
            own[4, s] = local[4, s] * ex + local[7, s] * ey + local[10, s] * ez + hinge * (y * push + cy)
            own[5, s] = local[5, s] * ex + local[8, s] * ey + local[11, s] * ez + hinge * (z * push + cz)
            own[6, s] = local[3, s] * ax + local[6, s] * ay + local[9, s] * az + slide * (x * push + 2.0 * cx)
            own[7, s] = local[4, s] * ax + local[7, s] * ay + local[10, s] * az + slide * (y * push + 2.0 * cy)
            own[8, s] = local[5, s] * ax + local[8, s] * ay + local[11, s] * az + slide * (z * push + 2.0 * cz)
        for j in range(i):
            if not chain[i, j]:
                continue
            before, now = twist[parent[i], j], twist[i, j]
            for s in range(count):
                px, py, pz = local[0, s], local[1, s], local[2, s]
                ux, uy, uz = before[0, s], before[1, s], before[2, s]
                vx = before[3, s] + uy * pz - uz * py
                vy = before[4, s] + uz * px - ux * pz
                vz = before[5, s] + ux * py - uy * px
                now[0, s] = local[3, s] * ux + local[6, s] * uy + local[9, s] * uz
                now[1, s] = local[4, s] * ux + local[7, s] * uy + local[10, s] * uz
                now[2, s] = local[5, s] * ux + local[8, s] * uy + local[11, s] * uz
                now[3, s] = local[3, s] * vx + local[6, s] * vy + local[9, s] * vz
                now[4, s] = local[4, s] * vx + local[7, s] * vy + local[10, s] * vz
                now[5, s] = local[5, s] * vx + local[8, s] * vy + local[11, s] * vz


@numba.njit(cache=True, fastmath=CONTRACT)
def _columns(motion, twist, count, out):  # type: ignore[no-untyped-def]
    """out (10, LANES): torque per unit of the ten parameters of a link with this motion, at the joint with this unit twist."""
    for s in range(count):
        wx, wy, wz = motion[0, s], motion[1, s], motion[2, s]
        ex, ey, ez = motion[3, s], motion[4, s], motion[5, s]
        ax, ay, az = motion[6, s], motion[7, s], motion[8, s]
        xx, yy, zz, xy, xz, yz = wx * wx, wy * wy, wz * wz, wx * wy, wx * wz, wy * wz
        ux, uy, uz = twist[0, s], twist[1, s], twist[2, s]
        vx, vy, vz = twist[3, s], twist[4, s], twist[5, s]
        out[0, s] = vx * ax + vy * ay + vz * az
        out[1, s] = -vx * (yy + zz) + vy * (xy + ez) + vz * (xz - ey) + uz * ay - uy * az
        out[2, s] = vx * (xy - ez) - vy * (xx + zz) + vz * (yz + ex) + ux * az - uz * ax
        out[3, s] = vx * (xz + ey) + vy * (yz - ex) - vz * (xx + yy) + uy * ax - ux * ay
        out[4, s] = ux * ex + uy * xz - uz * xy
        out[5, s] = ux * (ey - xz) + uy * (ex + yz) + uz * (xx - yy)
        out[6, s] = uy * ey - ux * yz + uz * xy
        out[7, s] = ux * (ez + xy) + uy * (zz - xx) + uz * (ex - yz)
        out[8, s] = ux * (yy - zz) + uy * (ez - xy) + uz * (ey + xz)
        out[9, s] = uz * ez + ux * yz - uy * xz


@numba.njit(cache=True, fastmath=CONTRACT)
def regressor(parent, rotation, position, axis, prismatic, chain, gravity, q, dq, ddq, out):  # type: ignore[no-untyped-def]
    """out (N, n, 10 n), zeroed by the caller: tau = out @ pi."""
    turns = joint_turns(rotation, axis)
    work, columns = workspace(axis, prismatic, gravity), np.empty((10, LANES))
    for first in range(0, len(q), LANES):
        part = slice(first, first + LANES)
        forward(parent, rotation, turns, position, axis, prismatic, chain, q[part], dq[part], ddq[part], work)
        count = min(LANES, len(q) - first)
        for i in range(len(parent)):
            for j in range(i + 1):
                if chain[i, j]:
                    _columns(work[0][i], work[1][i, j], count, columns)
                    for s in range(count):
                        for c in range(10):
                            out[first + s, j, 10 * i + c] = columns[c, s]


@numba.njit(cache=True, fastmath=CONTRACT)
def torque(parent, rotation, position, axis, prismatic, chain, gravity, mass, first, inertia, q, dq, ddq, out):  # type: ignore[no-untyped-def]
    """out (N, n), zeroed by the caller: inverse dynamics; first (n, 3) = m c, inertia (n, 3, 3) about the frame's origin; gravity (3,)."""
    turns = joint_turns(rotation, axis)
    work, wrench = workspace(axis, prismatic, gravity), np.empty((6, LANES))
    for begin in range(0, len(q), LANES):
        part = slice(begin, begin + LANES)
        forward(parent, rotation, turns, position, axis, prismatic, chain, q[part], dq[part], ddq[part], work)
        count = min(LANES, len(q) - begin)
        tau = out[part]
        for i in range(len(parent)):
            motion, m = work[0][i], mass[i]
            hx, hy, hz = first[i, 0], first[i, 1], first[i, 2]
            xx, yy, zz = inertia[i, 0, 0], inertia[i, 1, 1], inertia[i, 2, 2]
            xy, xz, yz = inertia[i, 0, 1], inertia[i, 0, 2], inertia[i, 1, 2]
            for s in range(count):
                wx, wy, wz = motion[0, s], motion[1, s], motion[2, s]
                ex, ey, ez = motion[3, s], motion[4, s], motion[5, s]
                ax, ay, az = motion[6, s], motion[7, s], motion[8, s]
                tx, ty, tz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
                wrench[3, s] = m * ax + ey * hz - ez * hy + wy * tz - wz * ty
                wrench[4, s] = m * ay + ez * hx - ex * hz + wz * tx - wx * tz
                wrench[5, s] = m * az + ex * hy - ey * hx + wx * ty - wy * tx
                lx, ly, lz = xx * wx + xy * wy + xz * wz, xy * wx + yy * wy + yz * wz, xz * wx + yz * wy + zz * wz
                wrench[0, s] = xx * ex + xy * ey + xz * ez + wy * lz - wz * ly + hy * az - hz * ay
                wrench[1, s] = xy * ex + yy * ey + yz * ez + wz * lx - wx * lz + hz * ax - hx * az
                wrench[2, s] = xz * ex + yz * ey + zz * ez + wx * ly - wy * lx + hx * ay - hy * ax
            for j in range(i + 1):
                if chain[i, j]:
                    unit = work[1][i, j]
                    for s in range(count):
                        power = unit[0, s] * wrench[0, s] + unit[1, s] * wrench[1, s] + unit[2, s] * wrench[2, s]
                        power += unit[3, s] * wrench[3, s] + unit[4, s] * wrench[4, s] + unit[5, s] * wrench[5, s]
                        tau[s, j] += power
