"""A recording as arrays: what was measured, what was commanded, when, and what is known about it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Event:
    """One line of `/events`: instant on the device clock (s), level (ROS: 10 debug, 20 info, 30 warn, 40 error), text."""

    t: float
    level: int
    name: str
    message: str


@dataclass(frozen=True)
class Log:
    """N samples of n joints on the device clock; NaN where nothing was reported.

    t            (N,) s, device clock, as recorded (a reader never sorts, drops or repairs samples)
    t_host       (N,) s, host clock at reception
    q dq tau     (N, n) rad, rad/s, N m: measured; tau is the torque that the drive reports
    q_cmd dq_cmd tau_cmd  (N, n) the last command at or before each sample
    current      (N, n) A
    temperature  (N, n) degC
    joint_names  names, in the order of the columns
    metadata     what the recording says of itself (arm, firmware, payload, clock fit, end reason, ...)
    events       lines of /events
    findings     sentences about damage, gaps and loss that the reader noticed
    """

    joint_names: tuple[str, ...]
    t: np.ndarray
    t_host: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    current: np.ndarray
    temperature: np.ndarray
    q_cmd: np.ndarray
    dq_cmd: np.ndarray
    tau_cmd: np.ndarray
    metadata: dict[str, Any] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    findings: tuple[str, ...] = ()
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.t)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)
