"""The mock arm: the MuJoCo plant behind the driver interface, on a simulated clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import Field

from drivers.driver import DeviceInfo, DeviceStop, Driver
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import Clock, MonotonicClock, SimulatedClock
from sim.errors import DeviceError
from sim.finite import is_finite
from sim.hidden import with_hidden_effects
from sim.joint_state import JointState, Status
from sim.plant import Plant
from sim.strict import Positive, StrictTable, validated
from sim.usual_arm import usual_arm


class MockOptions(StrictTable):
    """[options] of a mock cell: rate Hz, control rate; realtime: run on the wall clock; stop_deceleration rad/s^2 of the driver's own stop."""

    rate: Positive | None = None
    realtime: bool = False
    stop_deceleration: Positive = Field(default=4.0)


# A fault maps the reading about to be returned to the one that is returned instead.
Fault = Callable[[JointState], JointState]


class MockDriver(Driver):
    """The plant as a device. Hidden effects come from the cell's [emulation]; the tool sees only readings.

    `faults` are applied to every reading, for fault injection; `stop` decelerates at the cell's stop_deceleration, rad/s^2.
    """

    def __init__(
        self, plant: Plant, arm: Arm, rate: float, clock: Clock, stop_deceleration: float = 4.0, start: Any = None
    ) -> None:
        self.plant, self.arm, self.rate, self.clock = plant, arm, rate, clock
        self.faults: list[Fault] = []
        self._deceleration = stop_deceleration
        self.device_stop = DeviceStop(reaction=1.0 / rate, deceleration=stop_deceleration)
        self._start = np.zeros(arm.n) if start is None else np.asarray(start, dtype=float)
        self._stopping: np.ndarray | None = None
        self._connected = False
        self._q_cmd = self._start.copy()
        self._dq_cmd, self._tau_cmd = np.zeros(arm.n), np.zeros(arm.n)
        self._commanded = False

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> MockDriver:
        """The mock of a cell: its drive uses the nominal arm, its plant adds the cell's hidden effects.

        Sensors and drives that the arm's file does not state are ordinary ones (`sim.usual_arm`). The mock's drive knows their values,
        the tool does not.
        """
        options = validated(MockOptions, cell.table.options, cell.path)
        drive = usual_arm(arm)
        plant = Plant(
            with_hidden_effects(drive, cell), drive=drive, seed=cell.table.emulation.seed, obstacles=cell.table.obstacles
        )
        rate = options.rate or arm.sensors.rate
        clock: Clock = MonotonicClock() if options.realtime else SimulatedClock()
        return cls(plant, arm, rate, clock, options.stop_deceleration, cell.table.home)

    def connect(self) -> DeviceInfo:
        """Reset the plant to the cell's home."""
        self.plant.reset(self._start)
        self._next = self.clock.now()
        self._origin = self._next
        self._q_cmd, self._dq_cmd, self._stopping = self._start.copy(), np.zeros(self.arm.n), None
        self._tau_cmd, self._commanded = np.zeros(self.arm.n), False
        self._connected = True
        gravity = self.arm.gravity
        return DeviceInfo(
            model=self.arm.name, serial="mock", firmware="plant", rate=self.rate, gravity=(gravity[0], gravity[1], gravity[2])
        )

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Reset the plant to the cell's home; nothing moves it."""
        return self.connect()

    def read(self) -> JointState:
        """Next reading. Time passes without readers too: with `realtime`, periods in which nothing was read are skipped."""
        self._require_connection()
        period = 1.0 / self.rate
        while True:
            if self._stopping is not None:
                self._decelerate()
            elif not self._commanded:
                # a drive closes its loop every period, with or without a new command
                self.plant.command(self._q_cmd, self._dq_cmd, self._tau_cmd)
            self._commanded = False
            self.plant.advance(period)
            self._next += period
            if self.clock.now() - self._next < period:
                break
        self.clock.sleep_until(self._next)
        state = self.plant.read(self.clock.now())
        for fault in self.faults:
            state = fault(state)
        return state

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Command the plant; DeviceError for a command that is not finite or has a wrong length."""
        self._require_connection()
        arrays = [np.asarray(x) for x in (q, dq, tau)]
        if not all(is_finite(x, self.arm.n) for x in arrays):
            raise DeviceError(f"mock: command {q!r}: needs {self.arm.n} finite numbers; nothing was sent")
        self._stopping = None
        self._q_cmd, self._dq_cmd, self._tau_cmd = arrays
        self._commanded = True
        self.plant.command(*arrays)
        return arrays[0].copy()

    def stop(self) -> None:
        """Decelerate every joint from its last commanded speed to rest, all at the same deceleration."""
        if self._connected and self._stopping is None:
            self._stopping = self._dq_cmd.copy()

    def close(self) -> None:
        """Stop, wait for standstill, and release."""
        if not self._connected:
            return
        self.stop()
        for _ in range(int(20 * self.rate)):
            if self._stopping is None or not np.any(self._stopping):
                break
            self._decelerate()
            self.plant.advance(1.0 / self.rate)
        self._connected = False

    def _decelerate(self) -> None:
        """One control period of the device's own stop."""
        if self._stopping is None:
            return
        change = self._deceleration / self.rate
        self._stopping = np.sign(self._stopping) * np.maximum(np.abs(self._stopping) - change, 0.0)
        self._dq_cmd = self._stopping
        self._q_cmd = self._q_cmd + self._stopping / self.rate
        self.plant.command(self._q_cmd, self._stopping, np.zeros(self.arm.n))

    def _require_connection(self) -> None:
        if not self._connected:
            raise DeviceError(f"mock: {Status.DISCONNECTED.value}; call connect first")
