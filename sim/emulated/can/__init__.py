"""Emulated CAN servo arms: firmware of several drives on one bus with an arm behind them, reached like a real adapter."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import can

from sim.arm import Arm
from sim.can_wiring import CanOptions, can_options, pose
from sim.cell import Cell
from sim.emulated.can.box import BoxPort
from sim.emulated.can.bus import EmulatedBus, build_bus
from sim.emulated.can.port import Port
from sim.emulated.can.slcan import SlcanPort
from sim.emulated.can.socketcand import SocketcandPort
from sim.emulated.can.virtual import VirtualPort
from sim.emulated.promptness import answer_promptly
from sim.errors import ConfigError

TICK = 0.001  # s, the longest wait for the host
STALL = 0.01  # s that one cycle of the emulator may take
EARLY = 0.002  # s by which answers leave before their time on the wire, so that none is late


class BusClock:
    """Time on an emulated bus: the wall clock without the stalls of this computer beyond STALL.

    With the stalls, a drive would take the emulator's own pause for silence of its host and switch itself off.
    """

    def __init__(self, wall: Callable[[], float] = time.monotonic) -> None:
        self._wall, self._last, self._lost = wall, wall(), 0.0

    def now(self) -> float:
        """Bus time, s; read once in every cycle of the emulator."""
        wall = self._wall()
        self._lost += max(0.0, wall - self._last - STALL)
        self._last = wall
        return wall - self._lost


class CanEmulator:
    """One bus and one port, run by one thread between `start` and `stop`."""

    def __init__(self, bus: EmulatedBus, port: Port, where: str) -> None:
        self.bus, self.port, self.where = bus, port, where
        self.faults = bus.faults
        self._lock = threading.Lock()
        self._clock = BusClock()
        self._running = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Open the port and answer on it."""
        self.port.open()
        self._running = True
        self._thread = threading.Thread(target=self._run, name="emulated-can", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the port; safe to call more than once."""
        self._running = False
        if self._thread is not None:
            self._thread.join(5.0)
            self._thread = None
        self.port.close()

    def inject(self, fault: str) -> None:
        """Cause one of `faults`; callable from any thread."""
        with self._lock:
            self.bus.inject(fault)

    def instructions(self) -> list[str]:
        """Address of the bus, and the faults that can be caused on it."""
        return [
            f"{len(self.bus.servos)} {' and '.join(sorted({s.protocol for s in self.bus.servos}))} drives at {self.where}; next, in a second terminal: calib check with the same cell",
            "faults: " + ", ".join(f for f in self.faults if ":" not in f)
            + "; with a joint: " + ", ".join(sorted({f.partition(":")[0] for f in self.faults if ":" in f})),
            "Ctrl-C stops it",
        ]  # fmt: skip

    def _run(self) -> None:
        answer_promptly()
        plugged = True
        while self._running:
            with self._lock:
                state, stalled = self.bus.state, "tx-full" in self.bus.active and not isinstance(self.port, SlcanPort)
                wanted = "unplugged" not in self.bus.active
            if wanted != plugged:
                plugged = wanted
                if plugged:
                    self.port.open()
                else:
                    self.port.unplug()
            messages = self._receive(state, stalled) if plugged else self._wait()
            now = self._clock.now()
            with self._lock:
                for message in messages:
                    self.port.acknowledge(message, self.bus.send(message, now))
                due = self.bus.poll(now + EARLY)
                if plugged:
                    self.port.deliver(due)

    def _receive(self, state: str, stalled: bool) -> list[can.Message]:
        try:
            return self.port.receive(TICK, state, stalled)
        except (OSError, can.CanError):
            return self._wait()  # the host disconnected; it may return

    def _wait(self) -> list[can.Message]:
        time.sleep(TICK)
        return []


def emulator(cell: Cell, arm: Arm) -> CanEmulator:
    """The emulated drives of a can_servo cell; ConfigError if its interface has no emulated adapter."""
    options = can_options(cell, arm)
    bus = build_bus(cell, arm, options, pose(cell.table.rest, arm, "rest", cell))
    port, where = _port(cell, options)
    return CanEmulator(bus, port, where)


def _port(cell: Cell, options: CanOptions) -> tuple[Port, str]:
    if options.interface == "slcan":
        return SlcanPort(options.channel), options.channel
    if options.interface == "damiao":
        return BoxPort(options.channel), options.channel
    if options.interface == "socketcand":
        host, port = str(options.bus.get("host", "127.0.0.1")), options.bus.get("port", 29536)
        if not isinstance(port, int) or isinstance(port, bool):
            raise ConfigError(f"{cell.path}: options.bus.port = {port!r} is not a port number; write an integer")
        return SocketcandPort(host, port), f"socketcand://{host}:{port}"
    if options.interface == "virtual":
        return VirtualPort(options.channel), f"virtual channel {options.channel}"
    raise ConfigError(
        f"{cell.path}: interface {options.interface!r} has no emulated adapter; use slcan, damiao, socketcand or virtual"
    )
