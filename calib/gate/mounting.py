"""Does gravity pull as in the arm's model? An arm on a wall or a ceiling whose model stands on the floor.

    y_j - tau_j(g = 0) = sum_k g_k G_jk(q) + r ddq_j + v dq_j + c tanh(dq_j / 0.02) + o

G_jk the torque that gravity of one m/s^2 along axis k of the base frame takes: linear in the three numbers g, common to all joints.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from calib.gate.check import Cause, GateCheck
from calib.gate.fit import LEAST_ROWS, SLOW, fitted, model_torque, moving
from calib.gate.missing import mounting_torque
from calib.gate.signals import Signals
from sim.arm import Arm
from sim.rigid_body import RigidBody

# deg, nats by which it must explain more, each with a load and a pull, than the arm as modelled. Of 432 good recordings of 216 arms of exams none
# had more than 7 deg or 0.5 nats, turned arms 3.9 to 9.9 nats; a base that is less askew is found by diagnosis (base_tilt)
LEAST_ANGLE, LEAST_GAIN = 60.0, 1.0
LEAST_JOINTS = 2  # that gravity loads: of one alone it is the zero of its encoder


def mounting(arm: Arm, s: Signals, read: np.ndarray) -> tuple[GateCheck, Arm]:
    """The check, and the arm as the readings show it to be mounted: as it is where gravity pulls as modelled or not surely otherwise.

    read (n,): what the likeliest other way to read the recording leaves of each joint, which explains as much as a turn at times.
    """
    passed = (
        GateCheck("mounting", True, "gravity pulls in the direction of the arm's model, or its direction cannot be determined"),
        arm,
    )
    modelled, found = arm.tree.gravity, _gravity(arm, s)
    size = float(np.linalg.norm(modelled))
    if found is None or not size > 0:
        return passed
    measured = found * (size / np.linalg.norm(found))
    angle = math.degrees(math.acos(min(1.0, max(-1.0, float(measured @ modelled) / size**2))))
    if not angle > LEAST_ANGLE:
        return passed
    turned = replace(arm, tree=replace(arm.tree, gravity=measured))
    better = np.log(_least([*_left(arm, s), read]) / _least(_left(turned, s)))
    gain = float(better[np.isfinite(better)].sum())
    if not gain > LEAST_GAIN:
        return passed
    was, now = ("(" + ", ".join(f"{x:.1f}" for x in g + 0.0) + ")" for g in (modelled, measured))
    detail = f"gravity pulls along {now} m/s^2 of the base frame and along {was} in the model of {arm.name}"
    cause = f"the arm is mounted otherwise than its model, turned by {angle:.0f} deg: set gravity of <option> in its folder's model.xml"
    return GateCheck("mounting", False, detail, (Cause(cause, gain),), arm.joint_names), turned


def _gravity(arm: Arm, s: Signals) -> np.ndarray | None:
    """(3,) m/s^2 in the base frame that explains the readings best; None where fewer than LEAST_JOINTS joints show it."""
    body, still = RigidBody(arm), np.zeros_like(s.q)
    without = body.inverse_dynamics(s.q, s.dq, s.ddq, gravity=np.zeros(3))
    columns = np.stack([body.inverse_dynamics(s.q, still, still, gravity=axis) for axis in np.eye(3)], axis=2)
    x, y = [], []
    in_motion = moving(s)
    for j in range(s.n):
        rows = np.flatnonzero(in_motion[:, j] & np.isfinite(s.load[:, j]))
        if len(rows) < LEAST_ROWS:
            continue
        v = s.dq[rows, j]
        own = np.linalg.qr(np.column_stack([s.ddq[rows, j], v, np.tanh(v / SLOW), np.ones(len(rows))]))[0]
        both = np.column_stack([columns[rows, j], s.load[rows, j] - without[rows, j]])
        both = both - own @ (own.T @ both)
        deviation = float(both[:, -1].std())
        if deviation > 0 and float(np.abs(both[:, :-1]).max()) > 0:
            x.append(both[:, :-1] / deviation)
            y.append(both[:, -1] / deviation)
    if len(x) < LEAST_JOINTS:
        return None
    design, readings = np.concatenate(x), np.concatenate(y)
    if not (np.isfinite(design).all() and np.isfinite(readings).all()):
        return None
    found: np.ndarray = np.linalg.lstsq(design, readings, rcond=None)[0]
    return found if np.linalg.norm(found) > 0 else None


def _left(arm: Arm, s: Signals) -> list[np.ndarray]:
    """(n,) what the arm leaves of each joint: alone, with a load, and with a load and a pull."""
    plain = fitted(s, model_torque(arm, s))
    found = [plain.left]
    for beside, scaled in itertools.product(((), ("pull",)), (True, False)):
        held = replace(s, load=s.load - mounting_torque(arm, s, plain, beside, scaled))
        found.append(fitted(held, model_torque(arm, held)).left)
    return found


def _least(left: list[np.ndarray]) -> np.ndarray:
    return min(left, key=lambda one: float(np.nansum(np.log(one))))
