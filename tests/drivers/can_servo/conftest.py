"""A whole servo arm in this process: driver, emulated bus and drives, plant, all on one simulated clock."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.can_servo.driver import CanServo
from drivers.can_servo.link import Link
from sim.arm import Arm, load_arm
from sim.can_wiring import CanOptions, can_options
from sim.cell import Cell, load_cell
from sim.clock import SimulatedClock
from sim.emulated.can.bus import EmulatedBus, build_bus
from sim.emulated.can.stepped import SteppedBus
from sim.errors import DeviceError

WIDE = {"q": 12.57, "dq": 20.0, "tau": 60.0}


@dataclass
class Bench:
    """A test bench: the driver, the emulated bus behind it, and their common clock."""

    driver: CanServo
    bus: EmulatedBus
    clock: SimulatedClock
    cell: Cell
    k: int = 0

    @property
    def rest(self) -> np.ndarray:
        return np.array(self.cell.table.rest)

    def stream(self, cycles: int, amplitude: float = 0.1, frequency: float = 0.5) -> list:
        """Swing every joint from the rest pose and back, continuing where the last call ended; return the states."""
        n, rate = self.driver.arm.n, self.driver.rate
        states = []
        for _ in range(cycles):
            k, self.k = self.k, self.k + 1
            w = 2 * np.pi * frequency
            q = self.rest + amplitude * (1 - np.cos(w * k / rate)) / 2
            dq = np.full(n, amplitude * w * np.sin(w * k / rate) / 2)
            self.driver.send(q, dq, np.zeros(n))
            states.append(self.driver.read())
        return states


def cell_of(protocol: str, **changes) -> Cell:
    """The shipped cell with another protocol and other options."""
    cell = load_cell("emulated-servo6")
    options = {**cell.table.options, "protocol": protocol, **changes.pop("options", {})}
    servos = []
    for j, servo in enumerate(options["servos"]):
        servo = dict(servo)
        kind = protocol
        if protocol == "mixed":
            kind = servo["protocol"] = ("damiao", "robstride", "odrive")[j // 2]
        if kind == "cubemars":
            servo.update(ranges=WIDE, feedback=servo["node"])
            servo.pop("serial")
        elif kind == "robstride":
            servo.update(ranges=WIDE)
            servo.pop("feedback")
        elif kind == "odrive":
            servo.pop("feedback")
            servo.update(serial=f"{410001 + j:012X}", gear=8.0, watchdog_endpoint=401)
        servos.append(servo)
    options["servos"] = servos
    if protocol == "mixed":
        options["protocol"] = "damiao"
    if protocol == "cubemars":
        changes = {"assume": ["watchdog-works"], **changes}
    table = cell.table.model_copy(update={"options": options, **changes})
    return dataclasses.replace(cell, table=table)


@pytest.fixture(scope="session")
def servo6() -> Arm:
    return load_arm("servo6")


@pytest.fixture
def bench(servo6: Arm) -> Callable[..., Bench]:
    """Makes a bench for a protocol; options and cell keys may be changed."""
    made: list[Bench] = []

    def make(protocol: str = "damiao", **changes) -> Bench:
        cell = cell_of(protocol, **changes)
        options: CanOptions = can_options(cell, servo6)
        rest = np.array(cell.table.rest)
        bus, clock = build_bus(cell, servo6, options, list(rest)), SimulatedClock()
        for servo, table in zip(bus.servos, options.servos, strict=True):
            if servo.protocol == "odrive":
                servo.serial = int(table.serial or "0", 16)
                servo.watchdog = 0.1
        driver = CanServo(
            servo6, options, None if options.brakes else rest, clock, lambda: Link(SteppedBus(bus, clock), clock, "stepped"),
            hold_in_background=False,
        )  # fmt: skip
        made.append(Bench(driver, bus, clock, cell))
        return made[-1]

    yield make
    for item in made:
        with contextlib.suppress(DeviceError):
            item.driver.release()
