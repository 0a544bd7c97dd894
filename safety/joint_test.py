"""Is each joint the one that the model means, does its torque have the model's sign, and is it that arm?

Two degrees there and back, joint by joint; then a few slow lines for the gravity torque (`safety.gravity_sweep`).

Over the same path there and back, gravity cancels in half the difference of the torques. So does inertia, because each way
accelerates and decelerates alike. What remains is friction, which opposes the motion, so its sign is the sign of the torque
reading.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.driver import Check, Driver
from drivers.preflight import gravity
from drivers.torque_constants import torque_constants
from safety.approach import move
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.gravity_sweep import lines_from, sweep
from safety.guard import Guard
from safety.latency import latency_of
from safety.plausible import check_plausible
from safety.realtime import unhurried
from safety.run_progress import Cycle
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.joint_state import JointState

ANGLE = math.radians(2.0)
SHARE = 0.04  # of the arm's limits
PAUSE = 0.5  # s at each end, for joints that lag
RANGE = (0.5, 1.5)  # turn required of the joint, in units of ANGLE
OTHERS = 0.25  # turn allowed to the others, in units of ANGLE
REST_TOLERANCE = 0.1  # rad
CERTAIN = 3.0  # standard errors
MEMORY = 6.0  # readings of torque noise that count as one, because it is correlated from sample to sample


@dataclass(frozen=True)
class _Turn:
    """One joint's way there and back, cleared."""

    joint: int
    angle: float
    there: ClearedTrajectory
    back: ClearedTrajectory


def try_joints(
    driver: Driver,
    cell: Cell,
    stop_requested: Callable[[], str | None] = lambda: None,
    show: Callable[[str], None] = lambda sentence: None,
) -> list[Check]:
    """Turn every joint of a connected driver by ANGLE and back, one Check per joint; then check the gravity torque.

    Everything is verified before anything moves. SafetyStop if an arm with a rest pose is not there, or if neither direction of
    a joint can be verified; MotionStopped after a bounded stop if something goes wrong on the way.
    """
    arm = driver.arm
    check_plausible(arm, cell)
    q = driver.read().q
    _require_rest(arm, cell, q)
    clearance = Clearance(arm, cell)
    latency = latency_of(cell, driver)
    with unhurried():
        turns = [_turn(j, q, driver, cell, clearance, latency) for j in range(arm.n)]
        lines = [] if cell.table.rest is not None else lines_from(q, driver, cell, clearance, latency)
    seen: list[Cycle] = []
    checks = []
    with Guard(driver, arm, cell, clearance, stop_requested, seen.append, latency) as guard:
        for turn in turns:
            name = arm.joint_names[turn.joint]
            show(f"{name} by {math.degrees(turn.angle):+.0f} deg")
            ways: list[list[JointState]] = []
            for way in (turn.there, turn.back):
                seen.clear()
                guard.run(way, f"{name}, two degrees")
                guard.hold(PAUSE, f"after {name}")
                ways.append([cycle.state for cycle in seen])
            checks.append(compare(arm, turn.joint, turn.angle, *ways))
        if any(check.ok is False for check in checks):
            return checks
        if not lines:
            why = (
                "no nearby line can be verified" if cell.table.rest is None else "without brakes the arm stays at its rest pose"
            )
            return [*checks, Check("gravity torque", None, f"{why}, so it was not measured which arm this is")]
        show(f"{len(lines)} slow lines there and back, for the gravity torque")
        passed = sweep(lines, arm, guard, seen)
    found = gravity if passed.torque else torque_constants
    return [*checks, *found(driver, cell, passed.q, passed.gravity, passed.friction)]


def compare(arm: Arm, joint: int, angle: float, there: list[JointState], back: list[JointState]) -> Check:
    """Check joint order, sign and torque by the readings of a joint's way by `angle` rad and of its way back."""
    name, turned = arm.joint_names[joint], back[0].q - there[0].q
    others = np.delete(np.abs(turned), joint)
    j = int(np.argmax(np.abs(turned)))
    detail = (
        f"turned {math.degrees(turned[joint]):+.2f} deg for {math.degrees(angle):+.2f} deg, the others at most "
        f"{math.degrees(float(np.max(others, initial=0.0))):.2f} deg"
    )
    follows = RANGE[0] * ANGLE <= turned[joint] * np.sign(angle) <= RANGE[1] * ANGLE and bool(np.all(others <= OTHERS * ANGLE))
    title = f"move {name}"
    if not follows:
        return Check(
            title, False, detail + (f", {arm.joint_names[j]} most of all" if j != joint else ""),
            "the joint order or a direction differs from the arm file: compare joint names, nodes and directions with the arm",
        )  # fmt: skip
    against, doubt, unit = _friction(joint, float(np.sign(angle)), there, back)
    if not math.isfinite(against):
        return Check(title, True, f"{detail}; no torque is reported")
    detail += f"; it takes {against:.3g} {unit} in the direction of motion"
    if abs(against) <= CERTAIN * doubt:
        return Check(title, True, f"{detail} (± {doubt:.2g}: too little to tell the sign of the torque)")
    return Check(
        title, against > 0, detail,
        f"the torque of {name} opposes its motion: its sign or the order of the torques differs from the arm file",
    )  # fmt: skip


def _friction(joint: int, sign: float, there: list[JointState], back: list[JointState]) -> tuple[float, float, str]:
    """Half the difference of torque between the two ways, its standard error, and its unit.

    Current instead if a way has too few torque readings to estimate the error; NaN if there are too few currents too.
    """
    for quantity, unit in (("tau", "N m"), ("current", "A")):
        first, second = (_in_motion(way, joint, quantity) for way in (there, back))
        if min(len(first), len(second)) > MEMORY:
            variance = sum(float(np.var(load)) * MEMORY / len(load) for load in (first, second))
            return sign * float(np.mean(first) - np.mean(second)) / 2, math.sqrt(variance) / 2, unit
    return math.nan, math.nan, ""


def _in_motion(way: list[JointState], joint: int, quantity: str) -> np.ndarray:
    """The finite readings of `quantity` while the joint moves at more than half its top speed."""
    dq = np.abs([state.dq[joint] for state in way])
    load = np.array([getattr(state, quantity)[joint] for state in way])
    known = np.isfinite(dq) & np.isfinite(load)
    return load[known & (dq > 0.5 * np.max(dq[known], initial=0.0))]


def _require_rest(arm: Arm, cell: Cell, q: np.ndarray) -> None:
    if cell.table.rest is None:
        return
    away = np.abs(q - np.array(cell.table.rest))
    if not np.all(away <= REST_TOLERANCE):
        j = int(np.argmax(away))
        raise SafetyStop(
            f"{arm.joint_names[j]} stands {away[j]:.3f} rad away from the rest pose, where the arm may lose its torque afterwards; at most "
            f"{REST_TOLERANCE} rad is allowed: bring the arm to its rest pose first"
        )


def _turn(joint: int, q: np.ndarray, driver: Driver, cell: Cell, clearance: Clearance, latency: float) -> _Turn:
    refusal: SafetyStop | None = None
    for angle in (ANGLE, -ANGLE):
        end = q.copy()
        end[joint] += angle
        try:
            there, back = (
                clear(move(a, b, driver.arm, driver.rate, SHARE), driver.arm, cell, driver.rate, driver.device_stop, latency, clearance)
                for a, b in ((q, end), (end, q))
            )  # fmt: skip
            return _Turn(joint, angle, there, back)
        except SafetyStop as error:
            refusal = error
    raise SafetyStop(
        f"{driver.arm.joint_names[joint]} cannot turn by two degrees either way: {refusal}; move the arm to a freer posture"
    )
