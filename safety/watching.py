"""The monitor process: a second check of the arm, with a connection and a stop of its own, which the guard cannot block.

It loads arm, cell, plan and approval itself, maps the verified motions of a stage read-only, and checks every reading that it
receives with the rules of `safety.monitor`. It reports what it finds to the guard, whose stop is the better one. If the guard
is silent or continues, or its stop does not end, the monitor process brakes the arm itself and ends the control process. The
guard stops if the monitor process is silent.
"""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from drivers.driver import Driver
from safety import realtime
from safety.approval import approval_of, check_approval
from safety.audit import record
from safety.collision import Clearance
from safety.monitor_link import SEEN_TIME, Order, read, silence_of, write
from safety.plan import check_plan, load_plan
from safety.plausible import check_plausible
from safety.second_look import Watch
from safety.signs import ENDED, Signs
from safety.verified_samples import VerifiedSamples
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError, DeviceError, SafetyStop
from sim.joint_state import JointState

GRACE = 10.0  # s for the control process to end after its device was stopped
POLL = 5e-4
KEPT = 1 << 20  # cycles whose time is kept


@dataclass(frozen=True)
class Task:
    """What the monitor process loads itself, and the PID of the control process that it watches."""

    plan: Path
    cell: Path
    arm: Path
    driver_factory: Callable[[Cell, Arm], Driver]
    audit: Path
    control: int


def watch(task: Task, signs: Signs, talk: Connection) -> None:
    """Run the monitor process until the control process has ended or was ended. Its errors go to the control process."""
    os.setsid()
    control = os.pidfd_open(task.control)
    try:
        plan, cell, arm = load_plan(task.plan), load_cell(task.cell), load_arm(task.arm)
        check_plan(plan, arm, cell)
        approval = approval_of(plan)
        if approval is None:
            raise SafetyStop(f"{plan.folder}: nobody has approved this plan")
        check_approval(approval, plan, arm, cell, datetime.now(UTC))
        check_plausible(arm, cell)
        driver = task.driver_factory(cell, arm)
        process = _Process(arm, cell, driver, signs, talk, Clearance(arm, cell))
        realtime.prepare()
    except CalibError as error:
        write(talk, str(error))
        return
    try:
        reason = process.run()
        signs.trip(reason)
        if driver.sole:
            _end(control)
        try:
            driver.halt()
        except DeviceError as error:
            signs.halted(str(error))
            reason = f"{reason}; {error}"
        else:
            signs.halted()
        # a control process that finds the device stopped closes the log and reports why; a hung one does not
        if not select.select([control], [], [], GRACE)[0]:
            _end(control)
        record(task.audit, "monitor took over", datetime.now(UTC), reason=reason)
    except (EOFError, OSError):  # the control process has ended, with the arm at rest
        pass
    except CalibError as error:
        with suppress(OSError):
            write(talk, str(error))
    finally:
        driver.close()


def _end(process: int) -> None:
    """Send SIGKILL to the process of a pidfd, if it still exists."""
    with suppress(ProcessLookupError):
        signal.pidfd_send_signal(process, signal.SIGKILL)


def figures(spent: np.ndarray) -> dict[str, float]:
    """Number of cycles, and p50, p99.9 and maximum, us, of their CPU time and wall time from arrival to verdict (K, 2) s."""
    rows = zip(("p50", "p99.9", "max"), 1e6 * np.percentile(spent, [50, 99.9, 100], axis=0), strict=True)
    return {"cycles": len(spent)} | {
        f"{name}{of} us": float(x) for name, row in rows for of, x in zip(("", " wall"), row, strict=True)
    }


class _Process:
    """The loop of the monitor process."""

    def __init__(self, arm: Arm, cell: Cell, driver: Driver, signs: Signs, talk: Connection, clearance: Clearance) -> None:
        self._arm, self._cell, self._driver, self._signs, self._talk = arm, cell, driver, signs, talk
        self._clearance, self._listens = clearance, False
        self._per_cycle = 0.0  # s of CPU per cycle, all threads of this process, in the last stage

    def run(self) -> str:
        """Run stage after stage; return why the arm must be taken from the guard. EOFError if the control process has ended."""
        while True:
            order = Order(**read(self._talk))
            tube = VerifiedSamples(Path(order.file), order.counts, self._arm, self._cell, order.rate)
            write(self._talk, True)
            while self._signs.last().k == ENDED:
                if self._talk.poll(POLL):
                    read(self._talk)  # nothing is sent before the stage ends, so the other end is closed
            reason, spent = self._stage(order, tube)
            if reason is not None:
                return reason
            write(self._talk, figures(spent) | {"process us": 1e6 * self._per_cycle})

    def _stage(self, order: Order, tube: VerifiedSamples) -> tuple[str | None, np.ndarray]:
        """Why the arm must be taken from the guard, or None; and s of each cycle (K, 2): CPU, and from arrival to verdict."""
        spent, count, cpu = np.zeros((KEPT, 2)), 0, time.process_time()
        rules = Watch(
            self._arm, self._cell, order.rate, self._clearance, self._newest(order.rate, order.latency), order.latency, tube
        )
        clock = self._driver.clock
        state: JointState | None = self._newest(order.rate, order.latency)  # readings from while the rules were built are old
        while True:
            state = self._heard(state, rules)
            begin, now, sign = time.thread_time(), clock.now(), self._signs.last()
            reason = rules.look(state, now, sign)
            if rules.trip is not None:
                self._signs.trip(rules.trip)
            self._signs.looked(now)
            took = time.thread_time() - begin, clock.now() - (now if state is None else state.t)
            spent[count % KEPT], count = took, count + 1
            if reason is not None or (sign.k == ENDED and (rules.at_rest or state is None)):
                self._per_cycle = (time.process_time() - cpu) / count
                return reason, spent[: min(count, KEPT)]
            if rules.at_rest and self._talk.poll(0):
                read(self._talk)  # as above: the control process has ended

    def _newest(self, rate: float, latency: float) -> JointState:
        """Start listening, or skip readings that waited meanwhile; DeviceError if no current one arrives within SEEN_TIME."""
        if not self._listens:
            # drives no longer answer if the program that polls them hangs: wait no longer for them than for that program
            self._driver.listen(silence_of(rate, latency))
            self._listens = True
        clock, end = self._driver.clock, self._driver.clock.now() + SEEN_TIME
        state = self._driver.read()
        while not clock.now() - state.t <= 2.0 / rate:
            if not clock.now() < end:
                raise DeviceError(
                    f"for {SEEN_TIME:g} s every reading was received more than {2e3 / rate:.3g} ms after it came; this computer is busy: "
                    "stop other work on it"
                )
            state = self._driver.read()
        return state

    def _heard(self, last: JointState | None, rules: Watch) -> JointState | None:
        """The next reading; None from the first one on that does not arrive."""
        if last is None:
            time.sleep(POLL)
            return None
        try:
            return self._driver.read()
        except DeviceError as error:
            rules.deaf = str(error)
            return None
