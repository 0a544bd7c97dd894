"""One reading of all joints at one instant, and the condition of the device at that instant."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np

from sim.finite import real_array


class Status(enum.Enum):
    """Condition of the device; the value is the sentence shown to people."""

    RUNNING = "the device follows commands"
    IDLE = "the device is on and does not follow commands"
    PROTECTIVE_STOP = "the device is in protective stop"
    EMERGENCY_STOP = "the emergency stop is pressed"
    FAULT = "the device reports a fault"
    DISCONNECTED = "there is no connection to the device"


@dataclass(frozen=True, slots=True)
class JointState:
    """What a device reports at one instant; SI units, joint side of the gear; NaN where nothing is reported.

    t            host monotonic clock, s
    t_device     device clock, s
    q            (n,) rad
    dq           (n,) rad/s
    tau          (n,) N m, the torque that the drive reports
    current      (n,) A
    temperature  (n,) degC
    """

    t: float
    t_device: float
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    current: np.ndarray
    temperature: np.ndarray
    status: Status = Status.RUNNING
    detail: str = field(default="")

    def __post_init__(self) -> None:
        if not isinstance(self.status, Status):
            raise ValueError(f"JointState.status is {self.status!r}: give one of Status")
        n = np.shape(self.q)
        for name in ("q", "dq", "tau", "current", "temperature"):
            value = real_array(getattr(self, name), f"JointState.{name}")
            if value.ndim != 1 or value.shape != n:
                raise ValueError(f"JointState.{name} has shape {value.shape}, q has {n}: give one number for each joint")
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.q)
