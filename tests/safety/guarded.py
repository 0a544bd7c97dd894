"""A guarded run for fault injection: instant of the fault, recording in memory, and checks of a correct stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.recording import Recording
from safety.clear import ClearedTrajectory
from safety.collision import Clearance
from safety.guard import Guard
from safety.trip import MotionStopped
from safety.window import Window
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import DeviceError
from sim.joint_state import JointState
from tests.safety.perfect import PerfectDriver

AT = 700


class Log(Recording):
    """Keeps rows in memory; raises DeviceError once it holds `fails_at` rows."""

    def __init__(self, fails_at: int = 10**9) -> None:
        self.rows: list[tuple[JointState, np.ndarray]] = []
        self.events: list[str] = []
        self.fails_at = fails_at

    def write(self, state, q_cmd=None, dq_cmd=None, tau_cmd=None) -> None:  # type: ignore[no-untyped-def]
        if len(self.rows) >= self.fails_at:
            raise DeviceError("the disk is full")
        self.rows.append((state, q_cmd))

    def event(self, level: int, name: str, message: str, t_device: float) -> None:
        if len(self.rows) >= self.fails_at:
            raise DeviceError("the disk is full")
        self.events.append(message)

    def close(self, end_reason: str = "completed") -> None:
        self.events.append(end_reason)


def guard_of(driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, **more: object) -> Guard:
    return Guard(driver, arm, cell, clearance, **more).__enter__()  # type: ignore[arg-type]


def stopped_by(guard: Guard, cleared: ClearedTrajectory, log: Log | None = None) -> MotionStopped:
    with pytest.raises(MotionStopped) as stopped:
        guard.run(cleared, "friction", Window(log, 0, len(cleared)) if log else None)
    return stopped.value


def at_reading(n: int, change) -> object:  # type: ignore[no-untyped-def]
    return lambda state, k: change(state) if k >= n else state


def first_slower(driver: PerfectDriver, cleared: ClearedTrajectory) -> int:
    """Index of the first command that is not the planned one."""
    for k, (q, _) in enumerate(driver.sent):
        if not np.array_equal(q, cleared.q[k]):
            return k
    raise AssertionError("no command deviates")


def hot(state: JointState) -> JointState:
    return replace(state, temperature=np.full(6, 90.0))


def check_stop(driver: PerfectDriver, cleared: ClearedTrajectory, arm: Arm, stop: MotionStopped, n: int) -> None:
    """Check a stop whose fault appears in reading n (the guard's first is 1): command n - 2 is the first that deviates."""
    k = first_slower(driver, cleared)
    assert k == n - 2
    q = np.array([q for q, _ in driver.sent])
    dq = np.array([dq for _, dq in driver.sent])
    assert np.all(np.abs(np.diff(q, axis=0)) * 500 <= arm.dq_max * 1.001)
    assert np.all(np.abs(np.diff(dq, axis=0)) * 500 <= arm.ddq_max * 1.01)
    assert np.all(dq[-1] == 0)
    assert stop.standstill.at_rest
    assert driver.stops >= 1
    np.testing.assert_allclose(driver.q, q[-1])
    predicted, angle = np.array(stop.standstill.predicted_angle), np.array(stop.standstill.angle)
    np.testing.assert_allclose(angle, predicted, atol=0.1 * np.abs(predicted).max() + 1e-6)
