"""Robot state that the primary interface sends on connection: mode, kinematics, configuration and safety data.

Universal Robots, "Client Interfaces": robot state message 16, sub-packages robot mode 0, kinematics info 5, configuration data 6, safety data 10.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from sim.arm import Arm
from sim.dh import DhRows

SAFETY_CHECKSUM = 2588156642  # from the example in topic 988 of the manufacturer's forum
# RobotType in the manufacturer's client library
TYPES = {"UR5": 1, "UR10": 2, "UR3": 3, "UR16": 4, "UR8L": 6, "UR20": 7, "UR30": 8, "UR15": 9, "UR18": 10}


@dataclass(frozen=True)
class HeldArm:
    """What the controller knows about its arm: DH rows, position limits rad and largest speeds rad/s, (n,) each."""

    rows: DhRows
    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray


def nominal_rows(arm: Arm) -> DhRows:
    """DH rows of an uncalibrated UR, with its lengths d1 a2 a3 d4 d5 d6 from the model."""
    p = arm.tree.position
    half = np.pi / 2
    return DhRows(
        np.zeros(6), np.array([0, p[2][0], p[3][0], 0, 0, 0]), np.array([p[0][2], 0, 0, p[3][2], -p[4][1], p[5][1]]),
        np.array([half, 0, 0, half, -half, 0]),
    )  # fmt: skip


def held(arm: Arm, seed: int | None) -> HeldArm:
    """What the controller of an arm holds. With a seed, it is calibrated like a real one: offsets d of 5 to 20 m that cancel."""
    rows = nominal_rows(arm)
    if seed is not None:
        rng = np.random.default_rng(seed)
        theta, a, d, alpha = (x + rng.normal(0.0, s, 6) for x, s in zip(
            (rows.theta, rows.a, rows.d, rows.alpha), (5e-4, 2e-4, 2e-4, 5e-4), strict=True))  # fmt: skip
        slip = rng.uniform(5.0, 20.0)
        d[1], d[2] = d[1] + slip, d[2] - slip
        # the offset slides along two nearly parallel axes; only a small tilt keeps it from lifting the arm
        alpha[1] = rng.normal(0.0, 1e-5)
        rows = DhRows(theta, a, d, alpha)
    return HeldArm(rows, arm.q_min, arm.q_max, arm.dq_max)


def greeting(arm: HeldArm, model: str) -> bytes:
    """The robot state that a client receives first."""
    rows = arm.rows
    kinematics = struct.pack(">6I24dI", *range(1, 7), *rows.theta, *rows.a, *rows.d, *rows.alpha, 2)
    limits = np.column_stack([arm.q_min, arm.q_max]).ravel()
    motion = np.column_stack([arm.dq_max, np.full(6, 40.0)]).ravel()
    configuration = struct.pack(
        ">24d5d24d4i", *limits, *motion, 1.05, 1.4, 0.25, 1.2, 0.05, *rows.a, *rows.d, *rows.alpha, *rows.theta, 0, 3, TYPES.get(model, 0), 0
    )  # fmt: skip
    safety = struct.pack(">I", SAFETY_CHECKSUM)
    state = b"".join(
        _package(kind, body) for kind, body in ((0, b"\0" * 38), (5, kinematics), (6, configuration), (10, safety))
    )
    return _package(16, state)


def _package(kind: int, body: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(body), kind) + body
