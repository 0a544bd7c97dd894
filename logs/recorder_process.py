"""A recorder in its own process: the control loop hands samples over in microseconds and never waits for the disk."""

from __future__ import annotations

import contextlib
import json
import os
import struct
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from logs.about import About
from logs.journal import AHEAD
from logs.recorder import Recorder
from logs.recording import COMPLETED, Recording, metadata_text
from logs.recover import recovered
from logs.ring import Ring, forget, shared_memory
from sim.errors import DeviceError
from sim.joint_state import JointState, Status

SLOTS = 8192  # 16 s at 500 Hz: longer than a disk usually stalls
SAMPLE, EVENT = 1, 2
INDEX = struct.Struct("<Q")  # before each message in the ring: the number of earlier ones
START_TIME = 30.0  # s
CLOSE_TIME = 600.0  # s
PRIORITY = 1  # real-time priority while samples come: below every control loop, above all other programs
# libraries must not be loaded at the control loop's real-time priority: it is given up first
PROGRAM = """
import os, sys
if hasattr(os, "sched_setscheduler"):
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
from logs.recorder_process import serve
serve(sys.argv[1])
"""
_SAMPLE = struct.Struct("<BBBxxxxxdd")  # kind, status, whether a command is there, host clock, device clock
_STATUSES = tuple(Status)


class RecorderProcess(Recording):
    """The methods of `Recorder`; samples pass through a bounded ring in shared memory.

    `write` never waits. It raises DeviceError once the ring is full (the disk is too slow: samples are lost and counted, the
    recording ends aborted), once the recording process has failed to write, or once that process is gone. If this process dies,
    the recording process writes what the ring still holds and ends the file as killed.
    """

    def __init__(
        self,
        path: str | Path,
        joint_names: Sequence[str],
        metadata: Mapping[str, Any] | None = None,
        about: About | None = None,
        *,
        reserve: int = AHEAD,
        slots: int = SLOTS,
    ) -> None:
        """Start the recording process and wait until its file is open."""
        self.path, self.joint_names = Path(path), tuple(joint_names)
        self.samples = 0
        self._closed = False
        slot = -(-(256 + 64 * len(self.joint_names)) // 64) * 64
        self._put_count = 0
        fd, self._ring_name = shared_memory(Ring.size(slots, slot))
        about_fd = (about or About()).shared()
        try:
            self._ring = Ring(fd, slots, slot)
            task = {
                "fd": fd, "about": about_fd, "slots": slots, "slot": slot, "parent": os.getpid(), "path": str(self.path), "reserve": reserve,
                "joint_names": self.joint_names, "metadata": metadata_text(metadata or {}) | {"ring": self._ring_name},
            }  # fmt: skip
            root = str(Path(__file__).resolve().parent.parent)
            self._process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, json.dumps(task)],
                pass_fds=(fd, about_fd), start_new_session=True, stdin=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))},
            )  # fmt: skip
        except BaseException:
            forget(self._ring_name)
            raise
        finally:
            os.close(fd)
            os.close(about_fd)
        self._await_start()

    def _await_start(self) -> None:
        deadline = time.monotonic() + START_TIME
        while self._ring.note("ready") is None and self._process.poll() is None:
            if time.monotonic() > deadline:
                self._process.kill()
            time.sleep(0.002)
        if self._process.poll() is not None:
            forget(self._ring_name)
            raise DeviceError(self._failure())

    def write(
        self,
        state: JointState,
        q_cmd: np.ndarray | None = None,
        dq_cmd: np.ndarray | None = None,
        tau_cmd: np.ndarray | None = None,
    ) -> None:
        """Hand over one sample and the command that was sent with it; never wait."""
        n = len(self.joint_names)
        if state.n != n:
            raise ValueError(f"a state of {state.n} joints in a recording of {n}")
        commands = [
            np.full(n, np.nan) if value is None else np.asarray(value, dtype=float) for value in (q_cmd, dq_cmd, tau_cmd)
        ]
        if any(command.shape != (n,) for command in commands):
            raise ValueError(f"a command of shapes {[c.shape for c in commands]} in a recording of {n} joints")
        head = _SAMPLE.pack(SAMPLE, _STATUSES.index(state.status), q_cmd is not None, state.t, state.t_device)
        if not self.samples:
            self._ring.set_note("host", repr(state.t))
        arrays = (state.q, state.dq, state.tau, state.current, state.temperature, *commands)
        self._put(head + b"".join(array.tobytes() for array in arrays) + state.detail.encode("utf-8"))
        self.samples += 1

    def event(self, level: int, name: str, message: str, t_device: float) -> None:
        """Hand over a line of /events."""
        self._put(bytes([EVENT]) + json.dumps([level, name, message, t_device]).encode("utf-8"))

    def close(self, end_reason: str = COMPLETED) -> None:
        """End the recording as `Recorder.close` does; DeviceError where it could not be ended as a clean file."""
        if self._closed:
            return
        self._closed = True
        self._ring.set_note("end", end_reason)
        try:
            self._process.wait(CLOSE_TIME)
        except subprocess.TimeoutExpired:
            raise DeviceError(
                f"{self.path}: the recording process has not ended in {CLOSE_TIME:g} s; leave it running, or kill process "
                f"{self._process.pid} and recover the file with `calib import`"
            ) from None
        if self._process.returncode or self._ring.note("failure"):
            killed = (self._process.returncode or 0) < 0
            outcome = recovered(self.path) if killed else None
            if not killed:
                forget(self._ring_name)
            raise DeviceError(f"{self.path}: the recording process was {outcome}" if outcome else self._failure())

    def _put(self, data: bytes) -> None:
        self._check()
        if not self._ring.put(INDEX.pack(self._put_count) + data):
            raise DeviceError(self._failure())
        self._put_count += 1

    def _check(self) -> None:
        if self._ring.note("failure") or self._ring.lost or self._process.poll() is not None:
            raise DeviceError(self._failure())

    def _failure(self) -> str:
        reason = self._ring.note("failure")
        if reason:
            return reason
        if self._ring.lost:
            return (
                f"{self.path}: the disk cannot keep up with the samples: the ring of {self._ring.slots} is full and "
                f"{self._ring.lost} are lost; record to a faster disk, or at a lower rate"
            )
        return (
            f"{self.path}: the recording process is gone, or did not start in {START_TIME:g} s (exit code {self._process.returncode}); what it wrote can be recovered "
            "with `calib import`"
        )


def serve(task_text: str) -> None:
    """The recording process: write what the ring receives, until the recording is ended or the parent is gone."""
    task = json.loads(task_text)
    ring = Ring(task["fd"], task["slots"], task["slot"])
    os.close(task["fd"])
    about = About.received(task["about"])
    _prefer(True)
    try:
        recorder = Recorder(task["path"], task["joint_names"], task["metadata"], about, reserve=task["reserve"])
        ring.set_note("ready", "yes")
        _record(ring, recorder, task)
    except Exception as error:  # whatever it is, the control loop must learn of it
        ring.set_note("failure", str(error) or type(error).__name__)
        sys.exit(1)


def _prefer(wanted: bool) -> None:
    """Set or give up real-time priority, where the system grants it: a busy computer must not cost samples."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO if wanted else os.SCHED_OTHER, os.sched_param(PRIORITY if wanted else 0))


def _record(ring: Ring, recorder: Recorder, task: dict[str, Any]) -> None:
    n = len(recorder.joint_names)
    failure: DeviceError | None = None
    while True:
        orphan = os.getppid() != task["parent"]
        end = ring.note("end")
        data = ring.look()
        if data is None:
            if end is not None or orphan:
                break
            time.sleep(0.001)
            continue
        try:
            write_message(recorder, data, n)
        except DeviceError as error:
            failure = failure or error
            ring.set_note("failure", str(error))
        ring.let_go()
    _prefer(False)
    if ring.lost:
        recorder.close(f"{ring.lost} samples were lost: the disk was too slow")
    elif end is None:
        recorder.close_killed()
    else:
        recorder.close(end)
    forget(task["metadata"].get("ring", ""))
    if failure is not None:
        raise failure


def write_message(recorder: Recorder, message: bytes, n: int) -> None:
    """Pass a message of the ring, for `n` joints, to the recorder."""
    data = message[INDEX.size :]
    if data[0] == EVENT:
        level, name, text, t_device = json.loads(data[1:])
        recorder.event(level, name, text, t_device)
        return
    _, status, commanded, t, t_device = _SAMPLE.unpack_from(data)
    size = _SAMPLE.size + 64 * n
    arrays = np.frombuffer(data, offset=_SAMPLE.size, count=8 * n).reshape(8, n)
    q, dq, tau, current, temperature = arrays[:5]
    detail = data[size:].decode("utf-8")
    state = JointState(t, t_device, q, dq, tau, current, temperature, _STATUSES[status], detail)
    recorder.write(state, *(arrays[5:] if commanded else ()))
