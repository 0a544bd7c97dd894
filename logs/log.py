"""A recording as arrays: what was measured, what was commanded and when, with its metadata."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

import numpy as np

from logs.clock_fit import ClockFit

MEASURED, COMMANDED = ("q", "dq", "tau", "current", "temperature"), ("q_cmd", "dq_cmd", "tau_cmd")
CHANNELS = (*MEASURED, *COMMANDED)  # the arrays of a log with a column for each joint
SAMPLES = ("t", "t_host", *CHANNELS)  # the arrays with a row for each sample


class State(Enum):
    """How the recording ended; the value is the sentence shown to people."""

    CLEAN = "the recording was ended properly and is complete"
    ABORTED = "the recording was ended by a fault"
    KILLED = "the recording program was killed; what it had written is intact"
    OPEN = "the recording was never ended: it is still being written, or this cannot be determined"
    CUT = "the file is cut short, or a part of it is damaged"
    UNSTATED = "the file's format does not state how the recording ended"


@dataclass(frozen=True, slots=True)
class Event:
    """One line of `/events`: time on the log's `t` (s), level (ROS: 10 debug, 20 info, 30 warn, 40 error), name, text."""

    t: float
    level: int
    name: str
    message: str


@dataclass(frozen=True)
class Log:
    """N samples of n joints on the device clock; NaN where nothing was reported.

    t            (N,) s, device clock, relative to `t_origin`; `findings` states every change that a reader made
    t_host       (N,) s, host clock at reception, relative to `t_host_origin`; NaN where the format has none
    q dq tau     (N, n) rad, rad/s, N m: measured; tau is the torque that the drive reports
    q_cmd dq_cmd tau_cmd  (N, n) the last command at or before each sample
    current      (N, n) A, interpolated linearly between readings that have their own stamps
    temperature  (N, n) degC, the last reading at or before each sample
    joint_names  names, in the order of the columns
    metadata     what the recording states about itself (arm, firmware, payload, clock fit, end reason, ...); text as recorded
    events       lines of /events
    findings     sentences about damage, gaps and loss that the reader noticed
    state        how the recording ended
    clock        the fit between device and host clock; None without a host clock, or with too few data
    t_origin     device clock at t = 0, ns; t_host_origin is the same for the host clock. A float of seconds since 1970
                 resolves only 0.24 us, so the origins are kept as integers: device time = t_origin + 1e9 t
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
    metadata: dict[str, str] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    findings: tuple[str, ...] = ()
    path: Path | None = None
    state: State = State.UNSTATED
    clock: ClockFit | None = None
    t_origin: int = 0
    t_host_origin: int = 0

    def __len__(self) -> int:
        return len(self.t)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def period(self) -> float:
        """Median step of `t`, s; NaN where there are fewer than two samples."""
        return float(np.median(np.diff(self.t))) if len(self) > 1 else math.nan

    def part(self, rows: slice | np.ndarray) -> Log:
        """The log reduced to `rows`, on the same clock."""
        return replace(self, **{name: getattr(self, name)[rows] for name in SAMPLES})

    def with_joints(self, names: Sequence[str]) -> Log:
        """The log with these joints, in this order; ValueError where one is missing."""
        columns = [self.joint_names.index(name) for name in names]
        return replace(self, joint_names=tuple(names), **{name: getattr(self, name)[:, columns] for name in CHANNELS})
