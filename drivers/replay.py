"""A recorded log behind the driver interface: it returns every sample once, in order, and never moves anything."""

from __future__ import annotations

import numpy as np

from drivers.driver import DeviceInfo, Driver
from logs import read_log
from logs.log import Log
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import SimulatedClock
from sim.errors import DeviceError, EndOfRecording
from sim.joint_state import JointState, Status
from sim.strict import StrictTable, validated


class ReplayOptions(StrictTable):
    """[options] of a replay cell: the log to play, relative to the cell file."""

    log: str


class ReplayDriver(Driver):
    """A log as a device on a simulated clock; `send` is refused, and the end of the log raises EndOfRecording."""

    def __init__(self, log: Log, arm: Arm) -> None:
        if set(arm.joint_names) != set(log.joint_names):
            raise DeviceError(f"replay: the log has joints {list(log.joint_names)}, {arm.name} has {list(arm.joint_names)}")
        self.log, self.arm = log, arm
        self._order = [log.joint_names.index(n) for n in arm.joint_names]
        self.rate = 1 / log.period if len(log) > 1 else arm.sensors.rate
        self.clock = SimulatedClock()
        self._t_host = log.t_host if np.isfinite(log.t_host).all() else log.t  # ur_rtde CSV files have no host clock
        self._next: int | None = None

    @classmethod
    def from_cell(cls, cell: Cell, arm: Arm) -> ReplayDriver:
        """The driver of the log that a cell names."""
        options = validated(ReplayOptions, cell.table.options, cell.path)
        return cls(read_log(cell.path.parent / options.log, arm.joint_names), arm)

    def connect(self) -> DeviceInfo:
        """Rewind to the first sample."""
        self._next = 0
        self.clock = SimulatedClock(float(self._t_host[0]) if len(self.log) else 0.0)
        about = self.log.metadata
        return DeviceInfo(
            model=str(about.get("arm", self.arm.name)), serial=str(about.get("serial", "replay")),
            firmware=str(about.get("firmware", "log")), rate=self.rate,
        )  # fmt: skip

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Same as `connect`: a recording is only ever read."""
        return self.connect()

    def read(self) -> JointState:
        """The next recorded sample; EndOfRecording, a DeviceError, after the last."""
        k = self._next
        if k is None:
            raise DeviceError(f"replay: {Status.DISCONNECTED.value}; connect first")
        if k >= len(self.log):
            raise EndOfRecording("replay: the log has ended; nothing more to read")
        self._next = k + 1
        self.clock.sleep_until(float(self._t_host[k]))
        columns = (x[k, self._order] for x in (self.log.q, self.log.dq, self.log.tau, self.log.current, self.log.temperature))
        q, dq, tau, current, temperature = columns
        return JointState(self.clock.now(), float(self.log.t[k]), q, dq, tau, current, temperature)

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Refused: a recording cannot move."""
        raise DeviceError("replay: a recording cannot be commanded; use a mock, emulated or real cell to move")

    def stop(self) -> None:
        """Nothing moves."""

    def close(self) -> None:
        """Release the log."""
        self._next = None
