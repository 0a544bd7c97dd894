"""The monitor process: a second look at the arm, by a connection of its own and with a stop of its own, that the guard cannot hold up.

It loads arm, cell, plan and approval itself, maps the verified motions of a stage read-only, and checks every reading that it hears with
the rules of `safety.monitor`. What it finds it shows to the guard, whose stop is the better one. Where the guard is silent, or
goes on, or its stop does not end, it brakes the arm itself and ends the control process. The guard stops where the monitor process is silent.
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
from safety.coming_to_rest import STANDING_CYCLES
from safety.guard import STANDSTILL
from safety.monitor import Monitor
from safety.monitor_link import SEEN_TIME, Order, read, silence_of, write
from safety.plan import check_plan, load_plan
from safety.plausible import check_plausible
from safety.signs import ENDED, HOLDS, STOPS, Sign, Signs
from safety.verified_samples import VerifiedSamples
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError, DeviceError, SafetyStop
from sim.joint_state import JointState

# s after which a stopping arm must be slower than when its stop began, and after which it must stand
SLOWER_AFTER = 0.4
REST_AFTER = 4.0
GRACE = 10.0  # s for the control process to end after its device was stopped
POLL = 5e-4
KEPT = 1 << 20  # cycles whose time is kept


class Watch:
    """The rules of one stage. `look` at every reading; `trip` is why the guard was asked to stop, None as long as it was not."""

    def __init__(
        self, arm: Arm, cell: Cell, rate: float, clearance: Clearance, first: JointState, latency: float, tube: VerifiedSamples
    ) -> None:
        self.trip: str | None = None
        self.deaf = ""  # why no reading comes
        self._monitor = Monitor(arm, cell, rate, clearance, first, latency)
        self._tube, self._silence = tube, silence_of(rate, latency)
        self._steps = 1 + int(np.ceil(self._silence * rate))
        self._noise = STANDSTILL + 8 * np.array(arm.sensors.velocity_noise)
        self._leg, self._k, self._still = -1, ENDED, 0
        self._q: np.ndarray | None = None
        self._tripped_at = self._stopping_since = self._fastest = np.inf

    def look(self, state: JointState | None, now: float, sign: Sign) -> str | None:
        """Why the arm must be taken from the guard now, or None. state is None where no reading came."""
        if sign.k in (STOPS, ENDED):
            return self._stopping(state, now)
        if not now - sign.at <= self._silence:
            return f"the guard was silent for {1e3 * (now - sign.at):.0f} ms, {1e3 * self._silence:.0f} ms are allowed"
        if self.trip is None:
            self.trip = self._rules(state, now, sign)
            self._tripped_at = now
        elif not now - self._tripped_at <= self._silence:
            return f"the guard did not stop within {1e3 * self._silence:.0f} ms although: {self.trip}"
        return None

    @property
    def at_rest(self) -> bool:
        """Whether the arm was seen to stand after the guard began to stop it, or ended."""
        return self._still >= STANDING_CYCLES

    def _stopping(self, state: JointState | None, now: float) -> str | None:
        if self.at_rest:
            return None
        speed = np.inf if state is None else float(np.max(np.abs(state.dq)))
        stands = state is not None and bool((np.abs(state.dq) <= self._noise).all())  # once may be a turn
        self._still = self._still + 1 if stands else 0
        if self._stopping_since == np.inf:
            self._stopping_since, self._fastest = now, speed
        since = now - self._stopping_since
        if not (stands or since <= REST_AFTER):
            return f"the arm does not stand {REST_AFTER:g} s after its stop began"
        if not (stands or since <= SLOWER_AFTER or speed < self._fastest):
            return f"the arm is no slower {SLOWER_AFTER:g} s after its stop began"
        return None

    def _rules(self, state: JointState | None, now: float, sign: Sign) -> str | None:
        """The first rule that is broken, as a sentence."""
        if state is None:
            return f"the monitor process hears no readings any more: {self.deaf}"
        found = None
        if sign.k != HOLDS:
            found = self._tube.sample(sign.leg, sign.k)
            if found is None or sign.q.tobytes() != found[0].tobytes():
                return f"command {sign.k} of motion {sign.leg} is not one that was verified"
        elif self._q is not None and sign.q.tobytes() not in (q.tobytes() for q in (self._q, *self._tube.last(self._leg))):
            return "the command changes while the guard holds the arm"
        if (sign.leg, sign.k == HOLDS) != (self._leg, self._k == HOLDS):
            self._monitor.pause()
            before = -1
        else:
            before = self._k
        if sign.k != HOLDS and not before <= sign.k <= before + self._steps:
            return f"command {sign.k} of motion {sign.leg} comes after {before}"
        self._leg, self._k, self._q = sign.leg, sign.k, sign.q
        trip = self._monitor.check(state, now, sign.q, None if found is None else found[1])
        return None if trip is None else str(trip)


@dataclass(frozen=True)
class Task:
    """What the monitor process loads by itself, and whom it watches."""

    plan: Path
    cell: Path
    arm: Path
    driver_factory: Callable[[Cell, Arm], Driver]
    audit: Path
    control: int


def watch(task: Task, signs: Signs, talk: Connection) -> None:
    """The monitor process, until the control process has ended or was ended. What it cannot do it says to the control process."""
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
            reason = f"{reason}; {error}"
        # whoever finds the device stopped closes the log and says why; who hangs does not
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
    """SIGKILL to the process of a pidfd, where there still is one."""
    with suppress(ProcessLookupError):
        signal.pidfd_send_signal(process, signal.SIGKILL)


class _Process:
    """The loop of the monitor process."""

    def __init__(self, arm: Arm, cell: Cell, driver: Driver, signs: Signs, talk: Connection, clearance: Clearance) -> None:
        self._arm, self._cell, self._driver, self._signs, self._talk = arm, cell, driver, signs, talk
        self._clearance, self._listens = clearance, False

    def run(self) -> str:
        """Stage after stage, and at last why the arm must be taken from the guard. EOFError where the control process has ended."""
        while True:
            order = Order(**read(self._talk))
            tube = VerifiedSamples(Path(order.file), order.counts, self._arm, self._cell, order.rate)
            write(self._talk, True)
            while self._signs.last().k == ENDED:
                if self._talk.poll(POLL):
                    read(self._talk)  # nothing is sent before the stage ends: the other end is closed
            reason, spent = self._stage(order, tube)
            if reason is not None:
                return reason
            p50, p999 = np.percentile(spent, [50, 99.9]) * 1e6
            write(
                self._talk,
                {"cycles": len(spent), "p50 us": float(p50), "p99.9 us": float(p999), "max us": float(1e6 * spent.max())},
            )

    def _stage(self, order: Order, tube: VerifiedSamples) -> tuple[str | None, np.ndarray]:
        spent, count = np.zeros(KEPT), 0
        rules = Watch(
            self._arm, self._cell, order.rate, self._clearance, self._newest(order.rate, order.latency), order.latency, tube
        )
        clock = self._driver.clock
        state: JointState | None = self._newest(order.rate, order.latency)  # what came while the rules were made is old
        while True:
            state = self._heard(state, rules)
            begin, now, sign = time.thread_time(), clock.now(), self._signs.last()
            reason = rules.look(state, now, sign)
            if rules.trip is not None:
                self._signs.trip(rules.trip)
            self._signs.looked(now)
            spent[count % KEPT], count = time.thread_time() - begin, count + 1
            if reason is not None or (sign.k == ENDED and (rules.at_rest or state is None)):
                return reason, spent[: min(count, KEPT)]
            if rules.at_rest and self._talk.poll(0):
                read(self._talk)  # as above: the control process has ended

    def _newest(self, rate: float, latency: float) -> JointState:
        """Begin to listen, or pass over what was heard while nobody looked; DeviceError where nothing new comes within SEEN_TIME."""
        if not self._listens:
            # drives that answer a hung program no more must not be waited for longer than that program
            self._driver.listen(silence_of(rate, latency))
            self._listens = True
        clock, end = self._driver.clock, self._driver.clock.now() + SEEN_TIME
        state = self._driver.read()
        while not clock.now() - state.t <= 2.0 / rate:
            if not clock.now() < end:
                raise DeviceError(
                    f"for {SEEN_TIME:g} s every reading was heard later than {2e3 / rate:.3g} ms after it came; this computer is busy: "
                    "stop other work on it"
                )
            state = self._driver.read()
        return state

    def _heard(self, last: JointState | None, rules: Watch) -> JointState | None:
        """The next reading; none from the first on that did not come."""
        if last is None:
            time.sleep(POLL)
            return None
        try:
            return self._driver.read()
        except DeviceError as error:
            rules.deaf = str(error)
            return None
