"""A servo arm over CAN: codecs against the DBC files, cycle times and losses over two transports, reactions to faults.

The drives are emulated and share this computer with the driver. The wire figures therefore cover driver, python-can, emulated
drives and scheduler together, not a real bus. Reactions are measured on the simulated clock, where they are exact and
repeatable; they describe the driver's rules. `python -m benchmarks can` measures everything; `python -m benchmarks.can codec`,
`slcan`, `socketcand` or `reactions` measures one part.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import gc
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.can_codec import UNREACHABLE, codec
from drivers.can_servo.driver import CanServo
from drivers.can_servo.link import Link
from sim.arm import Arm, load_arm
from sim.can_wiring import can_options
from sim.cell import Cell, load_cell
from sim.clock import SimulatedClock
from sim.emulated import open_emulator
from sim.emulated.can.bus import build_bus
from sim.emulated.can.stepped import SteppedBus
from sim.errors import DeviceError

MEASURES = ("benchmarks.can", "drivers/can_servo")
RATE = 200.0
PRIORITY = 40
SPEED, REACH = 0.5, 0.25  # rad/s of every joint at the fault, rad amplitude of the motion
STANDSTILL = 0.05  # rad/s
JOINT = "elbow_joint"
# fault -> bar in periods, from the fault to the DeviceError
FAULTS = {
    f"silent:{JOINT}": 4, f"over-temperature:{JOINT}": 2, f"restarted:{JOINT}": 2, f"twin:{JOINT}": 3, "second-host": 2, "babble": 11,
    "error-frames": 3, "error-passive": 2, "bus-off": 2, "tx-full": 2, "unplugged": 2,
}  # fmt: skip


def cycles(transport: str, seconds: float) -> list[dict[str, Any]]:
    """Time from the first frame of a cycle to the last reply of six drives, and the losses."""
    with _wired(transport) as driver:
        took, late = _stream(driver, seconds)
        retries, link = driver.joints.lost, driver.link
        assert link is not None
        sent, received = link.sent, link.received
    load = f"{len(took)} cycles at {RATE:g} Hz, load {os.getloadavg()[0]:.1f}"
    p50, p99 = (round(1e6 * np.quantile(took, x)) for x in (0.5, 0.99))
    return [
        {"what": f"cycle of 12 frames over {transport}, p50 / p99", "value": f"{p50} / {p99}", "unit": "us", "note": load},
        {"what": f"cycles late by more than half a period, {transport}", "value": int(np.sum(late > 0.5 / RATE)), "unit": "cycles", "note": load},
        {"what": f"joints asked again a period later, {transport}", "value": retries, "unit": "", "note": load},
        {
            "what": f"frames lost in {seconds:g} s over {transport}", "value": sent - received, "unit": "frames", "bar": "0",
            "note": f"{sent} sent, {received} answers came, {load}",
        },
    ]  # fmt: skip


def _stream(driver: CanServo, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Swing all joints. Return, per cycle, the time from sending to the last reply and the lateness, s."""
    rest = driver.read().q
    driver.engage()
    rest, w, took, at = driver.read().q, 2 * np.pi * 0.25, [], []
    for k in range(round(seconds * RATE)):
        t = k / RATE
        q, dq = rest + 0.1 * (1 - np.cos(w * t)), np.full(6, 0.1 * w * np.sin(w * t))
        driver.send(q, dq, np.zeros(6))
        state = driver.read()
        took.append(state.t - state.t_device)
        at.append(state.t_device)
    return np.array(took), np.diff(at) - 1 / RATE


@contextlib.contextmanager
def _wired(transport: str) -> Iterator[CanServo]:
    """A connected driver with its drives in a separate process, both at real-time priority if permitted."""
    shipped = load_cell("emulated-servo6")
    with tempfile.TemporaryDirectory() as folder:
        where: dict[str, Any] = {
            "slcan": {"interface": "slcan", "channel": str(Path(folder) / "adapter.tty")},
            "socketcand": {
                "interface": "socketcand",
                "channel": "can0",
                "bus": {"host": "127.0.0.1", "port": 29536, "tcp_tune": True},
            },
        }[transport]
        options = {**shipped.table.options, **where, "rate": RATE, "watchdog": 0.5}
        cell = dataclasses.replace(shipped, table=shipped.table.model_copy(update={"options": options}))
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_emulate, args=(cell, there))
        process.start()
        try:
            here.recv()
            with _real_time():
                driver = CanServo.from_cell(cell, load_arm("servo6"))
                driver.connect()
                yield driver
                driver.release()
        finally:
            here.send("stop")
            process.join(10.0)


@contextlib.contextmanager
def _real_time() -> Iterator[None]:
    """Same settings as `calib record`: no garbage collection, and real-time priority if it is granted."""
    gc.collect()
    gc.freeze()
    gc.disable()
    before = os.sched_getscheduler(0)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, os.sched_param(0))
        gc.enable()


def _emulate(cell: Cell, pipe: Connection) -> None:
    emulator = open_emulator(cell, load_arm("servo6"))
    emulator.start()
    pipe.send("ready")
    pipe.recv()
    emulator.stop()


def reactions(repeats: int = 50, faults: Sequence[str] = tuple(FAULTS)) -> list[dict[str, Any]]:
    """Time from each fault to the DeviceError and to standstill, with the angle turned.

    Every joint moves at 0.5 rad/s; the fault comes at a random instant of the period. If nothing can be sent any more, the end
    is when the drives' watchdog disables them. A disabled drive lets its joint fall, so the angle is that of the other joints.
    """
    cell, arm = load_cell("emulated-servo6"), load_arm("servo6")
    rows = []
    for fault in faults:
        found = np.array([_reaction(cell, arm, fault, seed) for seed in range(repeats)])
        middle, worst = np.median(found, axis=0), np.max(found, axis=0)
        end = "drives let go" if fault in UNREACHABLE else "standstill"
        note = f"{repeats} repeats, {1e3 / RATE:g} ms each period, simulated clock"
        rows += [
            {"what": f"{fault}: noticed, median / worst", "value": f"{middle[0]:.2f} / {worst[0]:.2f}", "unit": "periods", "bar": f"<= {FAULTS[fault]}", "note": note},
            {"what": f"{fault}: {end}, median / worst", "value": f"{1e3 * middle[1]:.0f} / {1e3 * worst[1]:.0f}", "unit": "ms", "note": note},
            {"what": f"{fault}: angle until then, median / worst", "value": f"{np.degrees(middle[2]):.1f} / {np.degrees(worst[2]):.1f}", "unit": "deg", "note": note},
        ]  # fmt: skip
    return rows


def _reaction(cell: Cell, arm: Arm, fault: str, seed: int) -> tuple[float, float, float]:
    """Periods until the driver reports the fault, s until standstill or until the drives are disabled, rad turned by then."""
    rest = np.array(cell.table.rest)
    options = can_options(cell, arm)
    bus, clock = build_bus(cell, arm, options, rest.tolist()), SimulatedClock()
    driver = CanServo(
        arm, options, rest, clock, lambda: Link(SteppedBus(bus, clock), clock, "stepped"), hold_in_background=False
    )
    driver.connect()
    wait = np.random.default_rng(seed).uniform(0, 0.7 / RATE)  # between an answer and the next command
    start, begin, w = None, bus.body.plant.read().q, SPEED / REACH
    with contextlib.suppress(DeviceError):
        for k in range(400):
            phase = w * k / RATE
            driver.send(rest + REACH * (1 - np.cos(phase)), np.full(6, SPEED * np.sin(phase)), np.zeros(6))
            driver.read()
            if start is None and phase > np.pi / 2:
                clock.sleep_until(clock.now() + wait)
                bus.inject(fault)
                start, begin = clock.now(), bus.body.plant.read().q
        raise AssertionError(f"{fault} was not noticed within a second")
    assert start is not None
    noticed = clock.now() - start
    held = np.array([fault.startswith("twin") or not fault.endswith(name) for name in arm.joint_names])
    angle = 0.0
    driver.stop()
    while True:
        state = bus.body.plant.read()
        angle = max(angle, float(np.max(np.abs(state.q - begin)[held])))
        stands = np.max(np.abs(state.dq[held])) < STANDSTILL
        if not bus.body.live.any() or (stands and fault not in UNREACHABLE):
            break
        driver.keep()  # in real time the driver does this in the background
        clock.sleep_until(clock.now() + 1.0 / RATE)
        bus.advance(clock.now())
    took = clock.now() - start
    bus.inject("restore")
    with contextlib.suppress(DeviceError):
        driver.release()
    return noticed * RATE, took, angle


def run(seconds: float = 60.0, repeats: int = 50) -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    return codec() + cycles("slcan", seconds) + cycles("socketcand", seconds) + reactions(repeats)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.can", description=__doc__)
    parser.add_argument("part", nargs="+", choices=("codec", "slcan", "socketcand", "reactions"))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=50)
    given = parser.parse_args()
    parts: dict[str, list[Callable[[], list[dict[str, Any]]]]] = {
        "codec": [codec],
        "reactions": [partial(reactions, given.repeats, [fault]) for fault in FAULTS],
        **{wire: [partial(cycles, wire, given.seconds)] for wire in ("slcan", "socketcand")},
    }
    for make in (make for part in given.part for make in parts[part]):
        for row in make():
            line = f"{row['what']:70} {row['value']!s:>16} {row['unit']:8} bar {row.get('bar', ''):5} {row.get('note', '')}"
            print(line, flush=True)
