"""Poses of joint frames and speeds of link points over many samples, compiled by Numba; called only by `sim.rigid_body`."""

from __future__ import annotations

import numba
import numpy as np


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
def _placed(parent, rotation, position, axis, prismatic, q, turned, world_r, world_p, axes):  # type: ignore[no-untyped-def]
    """Fill world_r (n, 3, 3), world_p (n, 3) of every joint frame and axes (n, 3), all in the base's axes, at one q (n,)."""
    for i in range(len(parent)):
        up = parent[i]
        _joint_rotation(axis[i], 0.0 if prismatic[i] else q[i], turned)
        for c in range(3):
            at = world_p[up, c] if up >= 0 else 0.0
            for d in range(3):
                at += (world_r[up, c, d] if up >= 0 else (1.0 if c == d else 0.0)) * position[i, d]
            world_p[i, c] = at
        for c in range(3):
            x, y, z = rotation[i, c, 0], rotation[i, c, 1], rotation[i, c, 2]
            if up >= 0:
                u, v, w = world_r[up, c, 0], world_r[up, c, 1], world_r[up, c, 2]
                x = u * rotation[i, 0, 0] + v * rotation[i, 1, 0] + w * rotation[i, 2, 0]
                y = u * rotation[i, 0, 1] + v * rotation[i, 1, 1] + w * rotation[i, 2, 1]
                z = u * rotation[i, 0, 2] + v * rotation[i, 1, 2] + w * rotation[i, 2, 2]
            for d in range(3):
                world_r[i, c, d] = x * turned[0, d] + y * turned[1, d] + z * turned[2, d]
        for c in range(3):
            axes[i, c] = world_r[i, c, 0] * axis[i, 0] + world_r[i, c, 1] * axis[i, 1] + world_r[i, c, 2] * axis[i, 2]
        if prismatic[i]:
            for c in range(3):
                world_p[i, c] += axes[i, c] * q[i]


@numba.njit(cache=True)
def frames(parent, rotation, position, axis, prismatic, chain, q, world_r, world_p):  # type: ignore[no-untyped-def]
    """Rotation world_r (N, n, 3, 3) and origin world_p (N, n, 3) of every joint frame, in the base's axes."""
    axes, turned = np.empty((len(parent), 3)), np.empty((3, 3))
    for k in range(len(q)):
        _placed(parent, rotation, position, axis, prismatic, q[k], turned, world_r[k], world_p[k], axes)


@numba.njit(cache=True)
def point_speeds(parent, rotation, position, axis, prismatic, chain, links, begins, points, radii, q, dq, width, asked, out):  # type: ignore[no-untyped-def]
    """out (N, S): the largest of |J dq| + sum_j |J_j| width_j over a body's balls: radii (S,), points (P, 3) in links (S,).

    Body s has points[begins[s]:begins[s + 1]]. Computed only where asked (N, S); width (N, n) may be zero.
    """
    n = len(parent)
    world_r, world_p, axes, turned = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((3, 3))
    for k in range(len(q)):
        _placed(parent, rotation, position, axis, prismatic, q[k], turned, world_r, world_p, axes)
        for s in range(len(links)):
            if not asked[k, s]:
                continue
            link, radius, most = links[s], radii[s], 0.0
            ax = ay = az = 0.0
            for j in range(n):
                if chain[link, j] and not prismatic[j]:
                    ax, ay, az = ax + axes[j, 0] * dq[k, j], ay + axes[j, 1] * dq[k, j], az + axes[j, 2] * dq[k, j]
            turning = radius * np.sqrt(ax * ax + ay * ay + az * az)
            for p in range(begins[s], begins[s + 1]):
                px, py, pz = points[p, 0], points[p, 1], points[p, 2]
                r = world_r[link]
                tx = world_p[link, 0] + r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz
                ty = world_p[link, 1] + r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz
                tz = world_p[link, 2] + r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz
                vx = vy = vz = more = 0.0
                for j in range(n):
                    if not chain[link, j]:
                        continue
                    zx, zy, zz = axes[j, 0], axes[j, 1], axes[j, 2]
                    if prismatic[j]:
                        jx, jy, jz, rate = zx, zy, zz, 0.0
                    else:
                        rx, ry, rz = tx - world_p[j, 0], ty - world_p[j, 1], tz - world_p[j, 2]
                        jx, jy, jz, rate = zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx, 1.0
                    vx, vy, vz = vx + jx * dq[k, j], vy + jy * dq[k, j], vz + jz * dq[k, j]
                    more += (np.sqrt(jx * jx + jy * jy + jz * jz) + radius * rate) * width[k, j]
                speed = np.sqrt(vx * vx + vy * vy + vz * vz) + turning + more
                # a NaN speed stays NaN
                if speed > most or np.isnan(speed):
                    most = speed
            out[k, s] = most


@numba.njit(cache=True)
def jacobian(parent, rotation, position, axis, prismatic, chain, link, point, q, linear, angular):  # type: ignore[no-untyped-def]
    """linear and angular (N, 3, n): velocity of `point` (3,), fixed in `link`, per unit joint rate, in the base's axes."""
    n = len(parent)
    world_r, world_p, axes, turned = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((3, 3))
    target, arm, velocity = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(q)):
        _placed(parent, rotation, position, axis, prismatic, q[k], turned, world_r, world_p, axes)
        for c in range(3):
            r = world_r[link, c]
            target[c] = world_p[link, c] + r[0] * point[0] + r[1] * point[1] + r[2] * point[2]
        for j in range(n):
            if not chain[link, j]:
                continue
            z = axes[j]
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
