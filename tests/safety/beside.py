"""Test rig for the monitor process: it watches a dummy control process, and the test supplies the readings."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from drivers.driver import DeviceInfo
from safety import realtime, watching
from safety.clear import ClearedTrajectory
from safety.monitor_link import MonitorLink
from safety.plan import Plan
from safety.signs import HOLDS, Signs
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import MonotonicClock
from sim.errors import DeviceError
from sim.joint_state import JointState
from tests.safety.conftest import CONTEXT, state_at
from tests.safety.perfect import PerfectDriver

RATE = 50.0


class Ear(PerfectDriver):
    """The monitor's listening driver: `heard` supplies its readings; None makes `read` raise DeviceError."""

    def __init__(self, arm: Arm, cell: Cell, heard: Callable[[], JointState | None]) -> None:
        super().__init__(arm, cell, RATE, MonotonicClock())
        self.heard, self.listens, self.halts, self.closes = heard, 0, 0, 0

    def beside(self) -> str:
        return ""

    def listen(self, patience: float | None = None) -> DeviceInfo:
        self.listens += 1
        self.patience = patience
        return self.connect()

    def read(self) -> JointState:
        time.sleep(0.2 / RATE)
        state = self.heard()
        if state is None:
            raise DeviceError("nothing is heard any more")
        return state

    def halt(self) -> None:
        self.halts += 1

    def close(self) -> None:
        self.closes += 1


class Beside:
    """Runs the monitor process in a thread of this process; its control process is a child that only sleeps."""

    def __init__(
        self, place: tuple[Plan, Arm, Cell], talk: tuple[Connection, Connection], folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(os, "setsid", lambda: None)
        monkeypatch.setattr(realtime, "prepare", dict)
        monkeypatch.setattr(watching, "GRACE", 0.3)
        self.plan, self.arm, self.cell = place
        self.signs = Signs(6, CONTEXT)
        self.audit = folder / "audit.jsonl"
        self.child = os.fork()
        if self.child == 0:
            for end in talk:
                end.close()
            time.sleep(60)
            os._exit(0)
        self.state: JointState | None = state_at(0, q=np.array(self.cell.table.home))
        self.ear = Ear(self.arm, self.cell, self.heard)
        self.link = MonitorLink(self.signs, talk[0])
        task = watching.Task(
            self.plan.folder, self.cell.path, self.arm.model_path.parent, lambda cell, arm: self.ear, self.audit, self.child
        )
        self.thread = threading.Thread(target=watching.watch, args=(task, self.signs, talk[1]))
        self.thread.start()

    def heard(self) -> JointState | None:
        return (
            None
            if self.state is None
            else JointState(
                time.monotonic(),
                time.monotonic(),
                *(getattr(self.state, name) for name in ("q", "dq", "tau", "current", "temperature")),
            )
        )

    def begin(self, cleared: ClearedTrajectory, folder: Path) -> None:
        self.link.begin([cleared], RATE, 0.5, folder)
        self.show(HOLDS, cleared.q[0])
        while not self.link.sees:
            self.show(HOLDS, cleared.q[0])
            time.sleep(0.005)

    def show(self, k: int, q: np.ndarray) -> None:
        self.link.sent(k, q)

    def ended(self) -> int | None:
        """The signal that ended the control process, or None; waits up to 0.5 s for one."""
        end = time.monotonic() + 0.5
        while not (found := os.waitpid(self.child, os.WNOHANG))[0] and time.monotonic() < end:
            time.sleep(0.01)
        return os.WTERMSIG(found[1]) if found[0] else None
