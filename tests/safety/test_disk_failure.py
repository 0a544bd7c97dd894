"""A disk failure during a motion ends it in the planned stop, and the log never claims to be complete."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.mock import MockDriver
from logs import Recorder, State, read_log
from logs.journal import Disk
from safety import execution
from safety.clear import clear
from safety.collision import Clearance
from safety.guard import Guard
from safety.trip import MotionStopped
from safety.window import Window
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError, DeviceError
from sim.trajectory import Trajectory
from tests.safety.test_execution import go, short, with_fault


class FullDisk(Disk):
    """A disk on which `call` ("write" or "reserve") fails with "no space left" after `count` calls."""

    def __init__(self, call: str, count: int) -> None:
        self.call, self.left = call, count

    def _spend(self, call: str) -> None:
        self.left -= call == self.call
        if call == self.call and self.left < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write(self, fd: int, data: bytes) -> int:
        self._spend("write")
        return super().write(fd, data)

    def reserve(self, fd: int, start: int, size: int) -> None:
        self._spend("reserve")
        super().reserve(fd, start, size)


@pytest.mark.parametrize(("call", "count"), [("write", 600), ("reserve", 4)])
def test_the_motion_stops_as_planned(call: str, count: int, motion: Trajectory, arm: Arm, cell: Cell, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    clearance = Clearance(arm, cell)
    recorder = Recorder(path, arm.joint_names, reserve=400_000, disk=FullDisk(call, count))
    with MockDriver.from_cell(cell, arm) as driver:
        guard = Guard(driver, arm, cell, clearance).__enter__()
        cleared = clear(motion, arm, cell, driver.rate, driver.device_stop, 0.0, clearance)
        with pytest.raises(MotionStopped, match="No space left") as stopped:
            guard.run(cleared, "excitation", Window(recorder, 0, len(cleared)))
        assert np.abs(driver.read().dq).max() < 0.1
    standstill = stopped.value.standstill
    assert standstill.at_rest
    assert "the device's own stop" not in standstill.stop
    with pytest.raises(DeviceError, match="No space left"):
        recorder.close("stopped")
    log = read_log(path, accept_partial=True)
    assert log.state is State.ABORTED
    assert len(log) >= recorder.samples
    if call == "reserve":
        assert len(log) > recorder.samples + 10  # space had been reserved, so the stop itself is on the disk


def test_a_stop_is_reported_even_if_the_trail_cannot_be_written(
    arm: Arm, cell: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: Path, event: str, *args: object, **facts: object) -> None:
        if event == "run stopped":
            raise ConfigError(f"{file}: cannot be written (No space left on device)")

    monkeypatch.setattr(execution, "record", full)
    hot = with_fault(lambda s: replace(s, temperature=np.full(6, 90.0)) if s.t_device > 2.5 else s)
    with pytest.raises(MotionStopped, match="temperature") as stopped:
        go(tmp_path, arm, cell, [short()], hot)
    assert "No space left on device" in stopped.value.__notes__[-1]
