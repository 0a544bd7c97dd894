"""A driver whose arm follows every command exactly, one period later; faults occur only where a test injects them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.driver import DeviceInfo, DeviceStop, Driver
from safety.torque import torque_interval
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock, SimulatedClock
from sim.errors import DeviceError
from sim.joint_state import JointState
from sim.trajectory import Trajectory

Fault = Callable[[JointState, int], JointState]


class PerfectDriver(Driver):
    """Follows exactly; its own stop decelerates at 4 rad/s^2. `sent`, `reads` and `stops` are kept for tests."""

    device_stop = DeviceStop(reaction=0.0, deceleration=4.0)

    def __init__(self, arm: Arm, cell: Cell, rate: float, clock: Clock, with_torque: bool = False) -> None:
        self.arm, self._cell, self.rate, self.clock = arm, cell, rate, clock
        self._with_torque = with_torque
        self.q = np.array(cell.table.home, dtype=float)
        self.dq = np.zeros(arm.n)
        self.sent: list[tuple[np.ndarray, np.ndarray]] = []
        self.reads, self.stops = 0, 0
        self.stopping = False
        self.fault: Fault = lambda state, k: state
        self.send_fault: Callable[[int], None] = lambda k: None

    def connect(self) -> DeviceInfo:
        self._next = self.clock.now()
        return DeviceInfo(model="perfect", serial="1", firmware="1", rate=self.rate)

    def read(self) -> JointState:
        if self.stopping:
            self.dq = np.sign(self.dq) * np.maximum(np.abs(self.dq) - 4.0 / self.rate, 0)
            self.q = self.q + self.dq / self.rate
        while True:
            self._next += 1.0 / self.rate
            if self.clock.now() - self._next < 0.25 / self.rate:
                break
        self.clock.sleep_until(self._next)
        self.reads += 1
        nothing = np.full(self.arm.n, np.nan)
        state = JointState(self.clock.now(), self._next, self.q, self.dq, nothing, nothing, np.full(self.arm.n, 30.0))
        if self._with_torque:
            state = replace(state, tau=self._torque())
        return self.fault(state, self.reads)

    def _torque(self) -> np.ndarray:
        still = np.zeros((2, self.arm.n))
        here = Trajectory(np.array([0.0, 1.0]), np.vstack((self.q, self.q)), still, still)
        # a real sensor never repeats its last digit
        return torque_interval(here, self.arm, self._cell).tau_hat[0] + 1e-6 * np.sin(self.reads)

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        if not all(np.shape(x) == (self.arm.n,) and np.all(np.isfinite(x)) for x in (q, dq, tau)):
            raise DeviceError(f"not sent: {q}")
        self.send_fault(len(self.sent))
        self.stopping = False
        self.q, self.dq = np.array(q), np.array(dq)
        self.sent.append((self.q, self.dq))
        return self.q.copy()

    def stop(self) -> None:
        self.stops += 1
        self.stopping = True

    def close(self) -> None:
        self.stopping = True


def in_real_time(cell: Cell, arm: Arm) -> PerfectDriver:
    return PerfectDriver(arm, cell, 50.0, MonotonicClock())


def simulated(cell: Cell, arm: Arm) -> PerfectDriver:
    return PerfectDriver(arm, cell, 500.0, SimulatedClock())


class Clinging(PerfectDriver):
    """An arm without brakes: it fails in motion, `close` refuses to release it, and a thread keeps the process alive."""

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        if len(self.sent) > 60:
            raise DeviceError("a joint is silent")
        return super().send(q, dq, tau)

    def close(self) -> None:
        threading.Thread(target=time.sleep, args=(120.0,)).start()
        raise DeviceError("torque off would drop the arm")


def clinging(cell: Cell, arm: Arm) -> Clinging:
    return Clinging(arm, cell, 50.0, MonotonicClock())


def broken(cell: Cell, arm: Arm) -> PerfectDriver:
    raise ValueError("a bug of the driver")
