"""Records joint states, commands and events: a journal while it runs, a finished MCAP file after a proper end."""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from mcap.records import Metadata

from logs.about import About
from logs.boot import boot
from logs.encode import JointEncoder, log_body, message_record, text_body
from logs.finish import finish, killed_sentence
from logs.journal import AHEAD, Disk, Journal, record_bytes
from logs.recording import COMPLETED, ERROR, INFO, Recording, metadata_text
from logs.schemas import DEVICE_CLOCK, FRAME, STAMPS_END, STATES, TOPICS
from sim.errors import DeviceError
from sim.joint_state import JointState, Status
from sim.version import software_version

_STATES, _COMMANDS, _DIAGNOSTICS, _EVENTS, _DESCRIPTION = range(1, len(TOPICS) + 1)


class Recorder(Recording):
    """Every sample is on its way to the disk when `write` returns; a failed write is raised, then and by every later call.

    A recording is a journal (state open) at `path` until `close("completed")` turns it into a finished file of the same name
    (state clean). Any other end reason, or an exception in its context, makes it state aborted. `write` may raise DeviceError
    (disk full, unplugged, read-only): the motion must then stop, and the file is never reported as complete.
    """

    def __init__(
        self,
        path: str | Path,
        joint_names: Sequence[str],
        metadata: Mapping[str, Any] | None = None,
        about: About | None = None,
        *,
        reserve: int = AHEAD,
        disk: Disk | None = None,
        wall_clock: Callable[[], int] = time.time_ns,
    ) -> None:
        """`about` is attached; `reserve` bytes of disk are reserved first; `wall_clock` (ns) is read here and at the end."""
        self.path = Path(path)
        self.joint_names = tuple(joint_names)
        if not self.joint_names or len(set(self.joint_names)) != len(self.joint_names):
            raise ValueError(f"a recording needs different joint names, got {self.joint_names}")
        self.samples = 0
        self._wall_clock = wall_clock
        self._wall_start = wall_clock()
        self._host_start: float | None = None
        self._host_last = math.nan
        self._offset: int | None = None  # ns from the device clock to the stamps
        self._counts = [0] * (len(TOPICS) + 1)
        about = about or About()
        self._encoder = JointEncoder(self.joint_names, about.frame)
        self._temperature = b""
        self._status = Status.RUNNING
        self._closed = False
        head = metadata_text(metadata or {}) | {
            "software": software_version(),
            "joint_names": json.dumps(self.joint_names),
            "wall_clock_start_ns": str(self._wall_start),
            "boot": boot(),
            FRAME: about.frame,
        }
        first = self._record(_DESCRIPTION, self._wall_start, self._wall_start, text_body(about.urdf)) if about.urdf else b""
        # all in one write: a recovery relies on one seal for the head and one for each message
        self._journal = Journal(self.path, head, reserve, disk, about.attached(self._wall_start), first)
        self._lock = self._journal.lock()

    @classmethod
    def resumed(
        cls,
        journal: Journal,
        metadata: Mapping[str, str],
        counts: Mapping[str, int],
        host_start: float | None,
        offset: int | None,
    ) -> Self:
        """Continue the journal of a program that is gone; ValueError or KeyError where a recorder did not write `metadata`.

        counts: number of messages by topic. host_start: s, host clock of its first sample. offset: ns from the device clock to
        the stamps.
        """
        recorder = cls.__new__(cls)
        recorder.path = journal.path
        recorder.joint_names = tuple(map(str, json.loads(metadata["joint_names"])))
        recorder.samples = counts.get(STATES, 0)
        recorder._wall_clock, recorder._wall_start = time.time_ns, int(metadata["wall_clock_start_ns"])
        recorder._host_start, recorder._host_last, recorder._offset = host_start, math.nan, offset
        recorder._counts = [0, *(counts.get(topic, 0) for topic in TOPICS)]
        recorder._encoder = JointEncoder(recorder.joint_names, metadata.get(FRAME, ""))
        recorder._temperature, recorder._status, recorder._closed = b"", Status.RUNNING, False
        recorder._journal, recorder._lock = journal, journal.lock()
        return recorder

    def write(
        self,
        state: JointState,
        q_cmd: np.ndarray | None = None,
        dq_cmd: np.ndarray | None = None,
        tau_cmd: np.ndarray | None = None,
    ) -> None:
        """Append one sample and the command (n,) rad, rad/s, N m that was sent with it, in one write to the file."""
        if state.n != len(self.joint_names):
            raise ValueError(f"a state of {state.n} joints in a recording of {len(self.joint_names)}")
        stamp = self._stamp(state.t_device, state.t)
        if self._host_start is None:
            self._host_start = state.t
        self._host_last = state.t
        host = self._host_ns(state.t)
        records = []
        if self._offset is None:
            self._offset = host - stamp
            clock = {"offset_ns": str(self._offset), "meaning": "stamp = device clock + offset: wall time at the first sample"}
            records.append(record_bytes(Metadata(name=DEVICE_CLOCK, metadata=clock)))
        stamp = self._wall(stamp)
        records.append(self._joints(_STATES, host, stamp, (state.q, state.dq, state.tau)))
        if q_cmd is not None:
            command = [self._array(value) for value in (q_cmd, dq_cmd, tau_cmd)]
            records.append(self._joints(_COMMANDS, host, stamp, command))
        if self._brings_reading(state):
            records.append(self._joints(_DIAGNOSTICS, host, stamp, (state.current, state.temperature)))
        if state.status is not self._status:
            self._status = state.status
            level = INFO if state.status in (Status.RUNNING, Status.IDLE) else ERROR
            records.append(self._event(host, stamp, level, "status", f"{state.status.value} {state.detail}".strip()))
        self._journal.append(b"".join(records))
        self.samples += 1

    def event(self, level: int, name: str, message: str, t_device: float) -> None:
        """Append a line to /events at `t_device`, s on the device clock."""
        # before the first sample there is no host time to count from; the start of the recording is used
        host = self._wall_start if self._host_start is None else self._host_ns(self._host_last)
        stamp = host if self._offset is None else self._wall(self._stamp(t_device, 0.0))
        self._journal.append(self._event(host, stamp, level, name, message))

    def close(self, end_reason: str = COMPLETED) -> None:
        """End the recording: clean if `end_reason` is "completed", else aborted for that reason. Safe to call more than once.

        DeviceError where a write had failed or the finished file cannot be made; what was written stays in the journal.
        """
        if self._closed:
            return
        self._end("clean" if end_reason == COMPLETED else "aborted", end_reason)

    def close_killed(self) -> None:
        """End the recording of a control program that was killed: state killed, which readers treat as clean."""
        if not self._closed:
            last = None if self._host_start is None else self._host_ns(self._host_last)
            self._end("killed", killed_sentence(self.samples, last))

    def unlock(self) -> None:
        """Release this recorder's lock; a recording that was not ended counts as one of a killed program."""
        os.close(self._lock)

    def _end(self, state: str, reason: str) -> None:
        self._closed = True
        try:
            self._journal.close()
            finish(
                self.path, state,
                {
                    "end_reason": reason, "samples": str(self.samples), "wall_clock_end_ns": str(self._wall_clock()),
                    "host_clock_start": repr(self._host_start), "host_clock_end": repr(self._host_last),
                    "space_reserved": str(self._journal.reserves).lower(),
                },
            )  # fmt: skip
        finally:
            with contextlib.suppress(OSError):
                self.unlock()  # nobody may take the file for a dead one before it is finished

    def _brings_reading(self, state: JointState) -> bool:
        """Whether there is a current, or a temperature that differs from the last; currents are written with every sample."""
        temperature = state.temperature.tobytes()
        changed, self._temperature = temperature != self._temperature, temperature
        return not np.isnan(state.current).all() or (changed and not np.isnan(state.temperature).all())

    def _host_ns(self, t_host: float) -> int:
        """Host clock as wall time, ns: the wall clock at the start plus the time since the first sample."""
        return self._wall_start + round((t_host - (self._host_start or 0.0)) * 1e9)

    def _stamp(self, t_device: float, t_host: float) -> int:
        """The device clock unchanged, ns; DeviceError for times that cannot be recorded."""
        if not (math.isfinite(t_device) and math.isfinite(t_host) and 0 <= t_device < 2**31):
            raise DeviceError(
                f"{self.path}: instants {t_device} s (device) and {t_host} s (host) cannot be recorded; the device clock must be "
                "finite and within 0 to 2^31 s: check the driver"
            )
        return round(t_device * 1e9)

    def _wall(self, stamp: int) -> int:
        """A stamp of the device clock as wall time, ns; DeviceError where a ROS 2 stamp cannot hold it."""
        wall = stamp + (self._offset or 0)
        if not 0 <= wall < STAMPS_END:
            raise DeviceError(
                f"{self.path}: the instant {wall * 1e-9:.3f} s since 1970 cannot be recorded (1970 to 2038); set this computer's clock, "
                "and check the driver's"
            )
        return wall

    def _array(self, value: np.ndarray | None) -> np.ndarray:
        n = len(self.joint_names)
        array = np.full(n, np.nan) if value is None else np.asarray(value, dtype=float)
        if array.shape != (n,):
            raise ValueError(f"a command of shape {array.shape} in a recording of {n} joints")
        return array

    def _joints(self, channel: int, host: int, stamp: int, arrays: Sequence[np.ndarray]) -> bytes:
        return self._record(channel, host, stamp, self._encoder.body(stamp, arrays))

    def _event(self, host: int, stamp: int, level: int, name: str, text: str) -> bytes:
        return self._record(_EVENTS, host, stamp, log_body(stamp, level, name, text))

    def _record(self, channel: int, host: int, stamp: int, body: bytes) -> bytes:
        self._counts[channel] += 1
        return message_record(channel, self._counts[channel] - 1, max(host, 0), stamp, body)
