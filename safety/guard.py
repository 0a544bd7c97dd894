"""The only caller of `Driver.send`: a cleared sample per period, every reading checked, a bounded stop whatever goes wrong."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np

from drivers.driver import Driver
from logs.recording import ERROR, Recording
from safety.clear import ClearedTrajectory, require_cleared
from safety.collision import Clearance
from safety.coming_to_rest import ComingToRest
from safety.monitor import Expected, Monitor, compile_cycle
from safety.run_progress import Cycle
from safety.signs import ENDED, HOLDS, STOPS
from safety.stopping import Stop, stop_from
from safety.trip import STANDING, LastSamples, MotionStopped, Standstill, Trip, trip_of
from safety.window import Window, mark_gap
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import CalibError, SafetyStop
from sim.joint_state import JointState, Status

START_ANGLE = 0.01
JOIN = 1e-6
# rad by which a device's quantisation may change a command
QUANTISATION = 2e-3
STANDSTILL = 0.02
SWITCH_ON_TIME = 1.0


class Guard:
    """Drives cleared motions of one connected driver, one after another, each beginning where the last one ended.

    A context manager. On entry it reads, switches the device on if needed, and starts to monitor. On exit the device is
    commanded to stop, which changes nothing for an arm at rest. `sent(k, q)` gets every command q (n,) rad with the number of
    its sample, or HOLDS or STOPS, and ENDED on exit. `stop_requested()` returns the reason for a requested stop, or None; it is
    called every cycle. `watch` gets every cycle and must not block. After a stop the guard refuses every further motion: there
    is no automatic recovery.
    """

    def __init__(
        self,
        driver: Driver,
        arm: Arm,
        cell: Cell,
        clearance: Clearance,
        stop_requested: Callable[[], str | None] = lambda: None,
        watch: Callable[[Cycle], None] = lambda cycle: None,
        latency: float = 0.0,
        sent: Callable[[int, np.ndarray], None] = lambda k, q: None,
    ) -> None:
        self._sent, self._doing = sent, HOLDS
        self._driver, self._arm, self._stop_requested, self._watch = driver, arm, stop_requested, watch
        self._cell, self._clearance, self._latency = cell, clearance, latency
        compile_cycle()  # before the arm is switched on
        self._zero = np.zeros(arm.n)
        self._samples = LastSamples()
        self._ended: str | None = None
        self._record: Recording | None = None
        self._noise = STANDSTILL + 8 * np.array(arm.sensors.velocity_noise)
        self._q_cmd = self._dq_cmd = self._zero
        self._settled = False

    def __enter__(self) -> Self:
        """SafetyStop if the arm does not stand still, or does not follow once it is switched on."""
        first = self._first_reading()
        self._q_cmd = first.q.copy()
        try:
            self._driver.engage()
            if first.status is not Status.RUNNING:
                first = self._following()
            self.monitor = Monitor(self._arm, self._cell, self._driver.rate, self._clearance, first, self._latency)
        except BaseException:
            self._driver.stop()
            self._sent(ENDED, self._q_cmd)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            self._driver.stop()
        except CalibError:
            if error is None:  # an earlier error is the one to report
                raise
        finally:
            self._sent(ENDED, self._q_cmd)

    def _first_reading(self) -> JointState:
        state = self._driver.read()
        if state.status not in self._driver.ready:
            status = f"{state.status.value}{': ' + state.detail if state.detail else ''}"
            raise SafetyStop(f"before motion: {status}; bring the device to its running state and start again")
        if not (state.n == self._arm.n and np.isfinite(state.q).all() and np.isfinite(state.dq).all()):
            raise SafetyStop("before motion: the first reading is not complete; check the driver")
        if not (np.abs(state.dq) <= self._noise).all():
            raise SafetyStop(f"before motion: the arm moves at {state.dq.tolist()} rad/s; wait until it stands still")
        self._samples.add(state)
        return state

    def _following(self) -> JointState:
        """After `engage`, hold the arm where it is until the device reports that it follows."""
        state = self._samples.states[-1]
        for _ in range(round(SWITCH_ON_TIME * self._driver.rate)):
            self._send(self._q_cmd, self._zero)
            state = self._first_reading()
            if state.status is Status.RUNNING:
                return state
        raise SafetyStop(
            f"before motion: {state.status.value}, after {SWITCH_ON_TIME:g} s of commands to hold still; check the drives"
        )

    def run(self, motion: ClearedTrajectory, what: str, window: Window | None = None) -> None:
        """Send every sample of a motion that `clear` made; MotionStopped after a bounded stop if a rule is broken.

        Any other failure (driver, disk, a bug, an exception from `watch`) also ends in the bounded stop, and becomes the
        error's cause.
        """
        motion = require_cleared(motion, self._arm, self._driver.rate)
        self._refuse_after_stop()
        self._check_start(motion, what)
        self._drive(motion, len(motion), what, window)

    def hold(self, seconds: float, what: str) -> None:
        """Hold the last command for `seconds`, monitored as in motion; what: when, such as "after friction"."""
        self._refuse_after_stop()
        self._doing = HOLDS
        self._drive(None, max(1, round(seconds * self._driver.rate)), f"the pause {what}")

    def _drive(self, motion: ClearedTrajectory | None, cycles: int, what: str, window: Window | None = None) -> None:
        """Send the samples of a motion, or the last command again without one; stop once, and only after the loop has ended."""
        expected, last = None if motion is None else _expected(motion, 0), -1
        trip: Trip | None = None
        cause: BaseException | None = None
        self.monitor.pause()
        try:
            for k in range(cycles):
                trip = self._cycle(window, k, expected) or self._check_stop_request()
                if trip is not None:
                    break
                if motion is None:
                    self._send(self._q_cmd, self._zero)
                    continue
                self._doing = k
                self._send(motion.q[k], motion.dq[k])
                expected, last = _expected(motion, k), k
                self._watch(Cycle(k, cycles, self._samples.states[-1], self._q_cmd))
        except BaseException as error:
            trip, cause = trip_of(error), error
        try:
            if trip is not None:
                self._stop(motion, last, trip, what, cause)
        finally:
            self._record = None

    def _refuse_after_stop(self) -> None:
        if self._ended is not None:
            raise SafetyStop(f"the arm was stopped ({self._ended}); look at the cause and start a new run")

    def _check_start(self, motion: ClearedTrajectory, what: str) -> None:
        allowed = JOIN if self._settled else START_ANGLE
        gap = np.abs(motion.q[0] - self._q_cmd)
        if not ((gap <= allowed).all() and (np.abs(motion.dq[0] - self._dq_cmd) <= JOIN).all()):
            j = int(np.argmax(gap))
            raise SafetyStop(
                f"{what}: begins {gap[j]:.4g} rad away from the position of {self._arm.joint_names[j]}, or at another speed; "
                "an approach must bring the arm to its start"
            )
        self._settled = True

    def _cycle(self, window: Window | None, k: int, expected: Expected | None) -> Trip | None:
        """Read, record and let the monitor check."""
        before, state = self._samples.states[-1], self._read()
        if window is not None:
            self._record = window.recording if window.first <= k < window.last else None
        if self._record is not None:
            self._record.write(state, self._q_cmd, self._dq_cmd, self._zero)
            if window is not None and k > window.first:
                mark_gap(self._record, before, state, self._driver.rate)
        return self.monitor.check(state, self._driver.clock.now(), self._q_cmd, expected)

    def _check_stop_request(self) -> Trip | None:
        reason = self._stop_requested()
        return None if reason is None else Trip("stop requested:", reason, "none", "", "start again when the cause is gone")

    def _send(self, q: np.ndarray, dq: np.ndarray) -> None:
        sent = self._driver.send(q, dq, self._zero)
        if not (np.shape(sent) == q.shape and (np.abs(sent - q) <= QUANTISATION).all()):
            raise SafetyStop(f"the driver sent {sent!r} instead of {q!r}; it must send a command or raise")
        self._q_cmd, self._dq_cmd = q, dq
        self._sent(self._doing, q)

    def _stop(self, motion: ClearedTrajectory | None, k: int, trip: Trip, what: str, cause: BaseException | None) -> None:
        """Bring the arm to rest after sample k and raise MotionStopped from `cause`; a step that fails is added to the remedy."""
        self._ended, self._doing = str(trip), STOPS
        self._sent(STOPS, self._q_cmd)
        begin = self._samples.states[-1]
        good = self._samples.states[-2] if len(self._samples.states) > 1 else begin
        rest = ComingToRest(begin, good.q, self._noise, self._driver.rate)
        standstill: Standstill | None = None
        try:
            stop = Stop(STANDING, self._q_cmd[None], self._zero[None], 1.0 / self._driver.rate)
            if motion is not None and k >= 0:
                stop = stop_from(motion, k, self._arm)
            standstill = rest.by_commands(stop, self._dq_cmd, self._send, self._read_in_stop)
        except Exception as error:
            trip = replace(trip, remedy=f"{trip.remedy}; the stop failed: {error}")
        finally:
            try:
                self._driver.stop()
            except Exception as error:
                trip = replace(trip, remedy=f"{trip.remedy}; the device did not accept the stop command: {error}")
        if standstill is None or not standstill.at_rest:
            standstill = rest.by_device(self._driver.device_stop, self._q_cmd, self._dq_cmd, self._read, standstill)
        self._note(trip, begin)
        where = what if motion is None else f"{what}, sample {max(k, 0)}"
        raise MotionStopped(trip, begin.t_device, standstill, self._samples.latest(), where) from cause

    def _read_in_stop(self) -> JointState:
        state = self._read()
        if self._record is not None:
            # a failing disk must not delay the stop; the recording keeps its failure and reports it at its end
            with suppress(CalibError):
                self._record.write(state, self._q_cmd, self._dq_cmd, self._zero)
        if not (state.n == self._arm.n and np.isfinite(state.q).all() and np.isfinite(state.dq).all()):
            raise SafetyStop("a reading during the stop is not complete")
        return state

    def _read(self) -> JointState:
        state = self._driver.read()
        self._samples.add(state)
        return state

    def _note(self, trip: Trip, begin: JointState) -> None:
        """Write the reason to the log, if there is one; a failing disk no longer delays anything here."""
        if self._record is not None:
            try:
                self._record.event(ERROR, "safety", str(trip), begin.t_device)
            except CalibError as error:
                self._ended = f"{self._ended}; and the log: {error}"


def _expected(motion: ClearedTrajectory, k: int) -> Expected:
    return Expected(motion.tau_hat[k], motion.doubt[k], motion.sudden[k], float(motion.room[k]), motion.load[k])
