"""A UR over the wire, against the emulated controller: frames, late commands, and the reaction to each fault.

The emulated controller shares this computer with the driver, so the figures describe driver, ur_rtde and this computer, not a
robot. `python -m benchmarks ur` measures everything in half an hour; `python -m benchmarks.ur` with streaming or fault names
measures a part. Each figure states the load average.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ur_cell import ur_cell
from drivers import open_driver
from drivers.ur_rtde.driver import UrDriver
from sim.cell import Cell, load_arm_of, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.errors import DeviceError
from sim.joint_state import Status

MEASURES = ("benchmarks.ur", "drivers/ur_rtde")
SERVO_J = 11
SPEED = 0.5  # rad/s of joint 1 at the fault
FAULTS = (
    "protective_stop", "emergency_stop", "slider_moved", "program_stopped", "second_client", "cable_pulled", "close", "refuse",
    "drop", "delay", "freeze", "reorder",
)  # fmt: skip
PRIORITY = 40


@dataclass
class _Watch:
    """The controller's own time at every servoj command."""

    emulator: UrEmulator
    arrivals: list[float]

    @classmethod
    def of(cls, cell: Cell) -> _Watch:
        emulator = open_emulator(cell, load_arm_of(cell))
        assert isinstance(emulator, UrEmulator)
        watch = cls(emulator, [])
        write = emulator.robot.write_input

        def seen(name: str, value: float) -> None:
            if name == "input_int_register_0" and value == SERVO_J:
                watch.arrivals.append(emulator.robot.time)
            write(name, value)

        emulator.robot.write_input = seen  # type: ignore[method-assign]
        emulator.start()
        return watch

    def fault(self, name: str) -> tuple[float, float, float]:
        """Inject a fault and wait for standstill: host time of the fault, s; time to standstill, s; angle travelled, rad."""
        robot = self.emulator.robot
        begin: list[tuple[float, float]] = []
        self.emulator.inject(name)
        self.emulator.do(lambda: begin.append((time.monotonic(), robot.time)))
        while not begin:
            time.sleep(0.0005)
        start, end = robot.target_q[0], robot.time + 15.0
        while abs(robot.target_qd[0]) > 1e-3 and robot.time < end:
            time.sleep(0.0005)
        return begin[0][0], robot.time - begin[0][1], abs(robot.target_q[0] - start)


def _controller(path: str, priority: int, talk: Connection) -> None:
    _take_priority(priority)
    watch = _Watch.of(load_cell(path))
    talk.send("ready")
    while (order := talk.recv()) != "end":
        if order == "counts":
            talk.send(watch.arrivals)
        elif order == "again":
            watch.emulator.stop()
            watch = _Watch.of(load_cell(path))
            talk.send("ready")
        else:
            talk.send(watch.fault(order))
    watch.emulator.stop()


def _take_priority(priority: int) -> None:
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


@contextlib.contextmanager
def _pair(priority: int, last: int) -> Iterator[tuple[Connection, UrDriver]]:
    with tempfile.TemporaryDirectory() as folder:
        options: dict[str, object] = {"frame_timeout": 0.1, "setpoint_timeout": 0.1, "priority": priority}
        path = ur_cell(Path(folder) / "bench.toml", f"127.0.0.{last}", options=options)
        talk, theirs = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(target=_controller, args=(str(path), priority, theirs))
        process.start()
        talk.recv()
        cell = load_cell(path)
        driver = open_driver(cell, load_arm_of(cell))
        assert isinstance(driver, UrDriver)
        try:
            yield talk, driver
        finally:
            driver.close()
            talk.send("end")
            process.join()


def streaming(seconds: float = 60.0, priority: int = 0) -> list[dict[str, Any]]:
    """Frames kept of those sent, and commands more than a period late, over `seconds` of motion at 500 Hz.

    Frames sent are counted by their time stamps, one per period.
    """
    rt = f"FIFO {priority}" if priority else "no priority"
    # priority before connecting: the receiving thread inherits it from the thread that starts it, as in `calib record`
    with _pair(priority, 60) as (talk, driver), _priority() if priority else contextlib.nullcontext():
        driver.connect()
        q0 = driver.read().q
        first, zero = driver.link.frames, np.zeros(6)
        for k in range(round(seconds * driver.rate)):
            phase = 0.5 * k / driver.rate
            dq = np.array([0.3 * 0.5 * np.cos(phase), 0, 0, 0, 0, 0])
            driver.send(q0 + np.array([0.3 * np.sin(phase), 0, 0, 0, 0, 0]), dq, zero)
            driver.read()
        frames, lost = driver.link.frames - first, driver.link.lost
        talk.send("counts")
        arrivals = talk.recv()
        driver.stop()
    gaps = np.diff(arrivals) * driver.rate
    late = 100.0 * float(np.mean(gaps > 2.5))
    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    return [
        {"what": f"frames kept, {rt}", "value": round(100.0 * frames / (frames + lost), 3), "unit": "%", "bar": "100", "note": f"{frames} frames, {load}"},
        {"what": f"commands late by more than a period, {rt}", "value": round(late, 3), "unit": "%", "bar": "", "note": f"longest {gaps.max():.0f} periods, {load}"},
    ]  # fmt: skip


def reactions(repeats: int = 50, faults: Sequence[str] = FAULTS) -> list[dict[str, Any]]:
    """From each fault at 0.5 rad/s: time until the driver reports it, time and angle until standstill; median and worst."""
    rows = []
    for fault in faults:
        with _pair(0, 100 + FAULTS.index(fault)) as (talk, driver), _priority():
            tried, counted = 0, []
            while len(counted) < repeats and tried < 3 * repeats:
                tried += 1
                # skip a motion that a busy computer ended before its fault
                with contextlib.suppress(_TooEarly):
                    counted.append(_reaction(talk, driver, fault))
            found = np.array(counted)
        middle, worst = np.median(found, axis=0), np.max(found, axis=0)
        note = f"{len(counted)} repeats of {tried} tries, load {os.getloadavg()[0]:.1f}"
        for i, (what, unit, scale) in enumerate(
            (("noticed", "ms", 1e3), ("standstill", "ms", 1e3), ("angle", "deg", np.degrees(1.0)))
        ):
            value = f"{scale * middle[i]:.1f} / {scale * worst[i]:.1f}"
            rows.append({"what": f"{fault}: {what}, median / worst", "value": value, "unit": unit, "bar": "", "note": note})
    return rows


class _TooEarly(Exception):
    """The motion ended before its fault."""


@contextlib.contextmanager
def _priority() -> Iterator[None]:
    """Same settings as `calib record`: no garbage collection, and real-time priority if it is granted."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with contextlib.suppress(PermissionError):
            _take_priority(PRIORITY)
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        gc.enable()


def _reaction(talk: Connection, driver: UrDriver, fault: str) -> tuple[float, float, float]:
    """One fault in constant motion: s until it is noticed, s and rad until standstill. Leaves a new controller behind."""
    zero = np.zeros(6)
    driver.connect()
    q = driver.read().q.copy()
    fault_sent = False
    try:
        for k in range(round(20.0 * driver.rate)):
            speed = SPEED * min(1.0, k / 250)
            q[0] += speed / driver.rate
            driver.send(q, np.array([speed, 0, 0, 0, 0, 0]), zero)
            if driver.read().status is not Status.RUNNING:
                break
            if k == 400:
                talk.send(fault)
                fault_sent = True
    except DeviceError as error:
        if not fault_sent:
            driver.close()
            talk.send("again")
            talk.recv()
            raise _TooEarly(str(error)) from error
    noticed = time.monotonic()
    driver.stop()
    at, standstill, angle = talk.recv()
    driver.close()
    talk.send("again")
    talk.recv()
    return noticed - at, standstill, angle


def both(seconds: float = 60.0) -> list[dict[str, Any]]:
    """`streaming` with and without real-time priority."""
    rows = []
    for priority in (PRIORITY, 0):
        try:
            rows += streaming(seconds, priority)
        except (PermissionError, DeviceError) as error:
            what = f"streaming, FIFO {priority}" if priority else "streaming, no priority"
            rows.append({"what": what, "value": "not measured", "unit": "", "bar": "", "note": str(error)})
    return rows


def run(seconds: float = 60.0, repeats: int = 50) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    return both(seconds) + reactions(repeats)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ur", description=__doc__)
    parser.add_argument("part", nargs="+", choices=("streaming", *FAULTS))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=50)
    given = parser.parse_args()
    for part in given.part:
        for row in both(given.seconds) if part == "streaming" else reactions(given.repeats, [part]):
            print(f"{row['what']:60} {row['value']!s:>22} {row['unit']:4} bar {row['bar']:5} {row['note']}", flush=True)
