"""Whether gravity pulls as in the arm's model: the arm may hang on a wall or a ceiling while its model stands on the floor.

    y_j - tau_j(g = 0) = sum_k g_k G_jk(q) + r ddq_j + v dq_j + c tanh(dq_j / 0.02) + o

G_jk is the torque due to gravity of 1 m/s^2 along axis k of the base frame: linear in the three numbers g, which all joints share.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calib.gate.check import Cause, GateCheck
from calib.gate.fit import LEAST_ROWS, SLOW, fitted, gain, model_torque, moving
from calib.gate.missing import mounting_torque
from calib.gate.search import GainStep
from calib.gate.signals import Signals
from sim.arm import Arm
from sim.rigid_body import RigidBody

# deg, and nats by which the turned arm must explain more than the arm as modelled, each with a load and a pull. Of 432 good recordings of 216
# arms of exams none had more than 7 deg or 0.5 nats; turned arms had 3.9 to 9.9 nats. Diagnosis finds a smaller tilt of the base (base_tilt).
LEAST_ANGLE, LEAST_GAIN = 60.0, 1.0
TIE = 0.1  # nats: an arm that hangs may also be one whose first horizontal axis has another zero
SHOWN = 0.05  # of a joint's readings, which gravity must be able to cause
LEAST_JOINTS = 2  # that gravity loads: for one alone, the zero of its encoder explains as much
# gravity is missing if, at joints whose readings vary by less than 1/LARGE of what it would cause, it explains less than UNSEEN of every one, or
# its fitted size is below SMALL of the model's
LARGE, UNSEEN, SMALL = 3.0, 0.3, 0.15

Reading = tuple[list[GainStep], list[GainStep], Signals]  # `calib.gate.search.steps`


def pull_of_gravity(arm: Arm, s: Signals, read: Callable[[Arm], Reading]) -> tuple[GateCheck, Arm, Reading]:
    """The check, the arm mounted as the readings show it (unchanged unless gravity clearly pulls in another direction), and its reading.

    read(arm): what else is wrong with the recording of an arm mounted like that. Sometimes another way to read it explains as much as a turn.
    """
    passed = GateCheck(
        "gravity", True, "gravity pulls in the direction of the arm's model, or its direction cannot be determined"
    )
    reading, shown = read(arm), _shown(arm, s)
    if shown is None or shown.missing or not shown.angle > LEAST_ANGLE:
        return passed, arm, reading
    turned = replace(arm, tree=replace(arm.tree, gravity=shown.gravity))
    gained = gain(_least(_left(arm, s)), _least(_left(turned, s)))
    if not gained > LEAST_GAIN:
        return passed, arm, reading
    again = read(turned)
    over = gain(fitted(reading[2], model_torque(arm, reading[2])).left, _least(_left(turned, again[2])))
    simpler = 1 + len(again[0]) <= len(reading[0])
    if not (over > LEAST_GAIN or (simpler and over > -TIE)):
        return passed, arm, reading
    was, now = ("(" + ", ".join(f"{round(x, 1) + 0.0:.1f}" for x in g) + ")" for g in (arm.gravity, shown.gravity))
    cause = f"the arm is mounted differently from its model, turned by {shown.angle:.0f} deg: set gravity of <option> in its folder's model.xml"
    rivals = [step for step in reading[0][:1] if over < TIE]
    causes = [Cause(step.correction.sentence(arm.joint_names), min(step.gain, gained), (step.correction,)) for step in rivals]
    detail = f"gravity pulls along {now} m/s^2 of the base frame and along {was} in the model of {arm.name}"
    return GateCheck("gravity", False, detail, (Cause(cause, gained), *causes), arm.joint_names), turned, again


def no_gravity(arm: Arm, s: Signals) -> list[GateCheck]:
    """The failed check if several joints should show gravity and do not, else no check; for readings that no other way of reading explains."""
    shown = _shown(arm, s)
    if shown is None or not shown.missing:
        return []
    cause = (
        "the torque (or current) leaves out gravity, which the controller subtracts from what it reports, or the model is missing springs or counterweights "
        "that carry the arm; record the torque or current of the motors, or state the springs"
    )
    detail = "no gravity shows in the torque (or current)"
    return [GateCheck("gravity", False, detail, (Cause(cause, LEAST_GAIN),), arm.joint_names)]


@dataclass(frozen=True)
class Shown:
    """Gravity as the readings show it: (3,) m/s^2 in the base frame, of the model's size; angle deg to the model's; missing: none shows."""

    gravity: np.ndarray
    angle: float
    missing: bool


def _shown(arm: Arm, s: Signals) -> Shown | None:
    """Gravity as the readings show it; None where fewer than LEAST_JOINTS joints can show it."""
    modelled, size = arm.gravity, float(np.linalg.norm(arm.gravity))
    body, still = RigidBody(arm), np.zeros_like(s.q)
    columns = np.stack([body.inverse_dynamics(s.q, still, still, gravity=axis) for axis in np.eye(3)], axis=2)
    without = model_torque(arm, s) - columns @ modelled
    joints: list[tuple[np.ndarray, np.ndarray, float]] = []
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
        if np.isfinite(both).all() and size * np.linalg.norm(both[:, :-1].std(axis=0)) > SHOWN * deviation > 0:
            joints.append(
                (both[:, :-1] / deviation, both[:, -1] / deviation, float((both[:, :-1] @ modelled).std()) / deviation)
            )
    if len(joints) < LEAST_JOINTS:
        return None
    found = np.linalg.lstsq(np.concatenate([x for x, _, _ in joints]), np.concatenate([y for _, y, _ in joints]), rcond=None)[0]
    unseen = [float((y - x @ found).std()) > 1 - UNSEEN for x, y, expected in joints if expected > LARGE]
    if len(unseen) >= LEAST_JOINTS and (all(unseen) or np.linalg.norm(found) < SMALL * size):
        return Shown(np.zeros(3), math.nan, True)
    if not np.linalg.norm(found) > 0:
        return None
    gravity = found * (size / np.linalg.norm(found))
    return Shown(gravity, math.degrees(math.acos(min(1.0, max(-1.0, float(gravity @ modelled) / size**2)))), False)


def _left(arm: Arm, s: Signals) -> list[np.ndarray]:
    """(n,) residuals of each joint: of the arm alone, with a load, and with a load and a pull."""
    plain = fitted(s, model_torque(arm, s))
    found = [plain.left]
    for beside, scaled in itertools.product(((), ("pull",)), (True, False)):
        held = replace(s, load=s.load - mounting_torque(arm, s, plain, beside, scaled))
        found.append(fitted(held, model_torque(arm, held)).left)
    return found


def _least(left: list[np.ndarray]) -> np.ndarray:
    return min(left, key=lambda one: float(np.nansum(np.log(one))))
