"""Streaming to commanded drives: one frame per drive at each scheduled instant, and the answers to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from drivers.can_servo.drive import Drive
from drivers.can_servo.feedforward import Feedforward
from drivers.can_servo.joints import PERIODS_MAX, Joints
from drivers.can_servo.link import Link
from drivers.can_servo.speed import Speeds
from drivers.can_servo.switching import switch_on
from drivers.can_servo.target import Target
from sim.can_wiring import CanOptions
from sim.clock import Clock
from sim.errors import DeviceError
from sim.joint_state import JointState, Status

BRAKING = 4.0  # rad/s^2 of the fastest joint, the others in proportion: every arm of this kind can brake with it
STANDSTILL = 0.05  # rad/s


class Stream:
    """Commands and readings of an open bus. Every method raises a DeviceError for anything that a healthy bus does not carry.

    on: whether the drives are switched on.
    """

    def __init__(
        self, name: str, drives: Sequence[Drive], link: Link, clock: Clock, options: CanOptions, feedforward: Feedforward
    ) -> None:
        self.name, self.drives, self.link, self.clock = name, list(drives), link, clock
        self.options, self.rate = options, options.rate
        self.joints = Joints(drives, link, clock, self.rate, options.ignore)
        self.speeds = Speeds([(d.q_step, d.dq_step) for d in drives], self.rate)
        self.on = self._requested = False
        # Wait for a drive that sends by its own clock; one that answers gets another request at the next instant.
        self._patience = PERIODS_MAX / self.rate
        self._next = self._sent_at = clock.now()
        self._target = Target(drives, feedforward, BRAKING, PERIODS_MAX / self.rate)

    @property
    def holding(self) -> bool:
        """Whether the drives carry the arm and receive what they are sent."""
        return self.on and not self.link.failed

    def read(self) -> JointState:
        """All joints' answers to the last command; without one, a request is sent at the next scheduled instant."""
        if not self._requested:
            self._transmit(range(len(self.drives)))
        while True:
            self.joints.collect(self._next)
            missing = self.joints.missing()
            if missing and all(self.drives[j].pushes for j in missing):
                self.joints.collect(self._next + self._patience)
                missing = self.joints.missing()
            if not missing:
                break
            self.joints.lost += len(missing)
            self._transmit(missing)
        self._requested = False
        return self._state()

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Send one target at the next scheduled instant; return the positions after quantisation, rad."""
        sent = self._target.follow(q, dq, tau, self.clock.now())
        self._transmit(range(len(self.drives)))
        return sent

    def admitted(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> list[np.ndarray]:
        """Copies of a command; DeviceError unless it is finite and, if the arm is held or its drives are off, starts where it stands."""
        # writable copies: for read-only arrays the dynamics would be compiled again, which takes a second or more
        arrays, n = [np.array(x, dtype=float) for x in (q, dq, tau)], len(self.drives)
        if not all(x.shape == (n,) and bool(np.all(np.isfinite(x))) for x in arrays):
            raise DeviceError(f"{self.name}: a command needs {n} finite numbers each for q, dq, tau; nothing was sent")
        if self.on and not self._target.braking:
            return arrays
        stands = self._target.q if self.on else np.array([r.q for r in self.joints.readings if r is not None])
        away = np.abs(arrays[0] - stands)
        if not np.all(away <= self.options.start_tolerance):
            j = int(np.argmax(away))
            raise DeviceError(
                f"{self.drives[j].name}: the first command is {arrays[0][j]:.4f} rad and the joint stands at {stands[j]:.4f} rad; more than "
                f"{self.options.start_tolerance:g} rad apart would be a jump: begin where the arm stands"
            )
        return arrays

    def switch_on(self) -> None:
        """Switch the drives on, one joint after the other, each holding where it stands."""
        self._requested = False
        self._target.stand(self.read().q, self.clock.now())
        switch_on(self.link, self.joints, self.clock, self._target.frames)
        self.on, self._requested, self._sent_at = True, False, self.clock.now()
        self._next = self._sent_at + 1.0 / self.rate

    def take_over(self, state: JointState) -> None:
        """Command drives that another program has switched on, from their last state."""
        self._target.follow(state.q, state.dq, np.zeros(len(self.drives)), self.clock.now())
        self.on = True

    def hold(self) -> None:
        """Send one braking or holding frame to each drive at once, whatever else is on the bus, and process the answers."""
        self._sent_at = self.clock.now()
        self._target.brake(self._sent_at)
        fault: DeviceError | None = None
        try:
            self.joints.drain()
        except DeviceError as error:  # a babbling node, a second host: the arm gets its frames first
            fault = error
        self.joints.expect(range(len(self.drives)))
        self.link.send(self._target.frames)
        if fault is not None:
            raise fault
        self.joints.collect(self.clock.now() + 0.5 / self.rate)

    def neglected(self) -> bool:
        """Whether the arm is already braking, or no command has come for half the watchdog time."""
        return self._target.braking or self.clock.now() - self._sent_at > self.options.watchdog / 2

    def stands(self) -> bool:
        """Whether every joint stood still in its last reading."""
        return all(r is not None and abs(r.dq) < STANDSTILL for r in self.joints.readings)

    def _transmit(self, joints: Iterable[int]) -> None:
        """Send these joints the current target, or only a request while the drives are off, at the next scheduled instant."""
        joints = list(joints)
        self.clock.sleep_until(self._next)
        now, period = self.clock.now(), 1.0 / self.rate
        # The next instant keeps the phase and leaves at least half a period for the answers: lateness is not caught up.
        self._next += period * max(1, math.ceil((now - self._next) / period + 0.5))
        self._sent_at = now
        if self._target.braking:
            self._target.brake(now)
        messages = (
            [self._target.frames[j] for j in joints] if self.on else [m for j in joints for m in self.drives[j].refresh()]
        )
        self.joints.drain()
        self.joints.expect(joints)
        self.link.send(messages)
        self._requested = True

    def _state(self) -> JointState:
        readings = [r for r in self.joints.readings if r is not None]
        self.joints.require_health(self.on, self.options.temperature_max)
        nan = np.full(len(self.drives), np.nan)
        columns = {k: np.array([getattr(r, k) for r in readings]) for k in ("q", "dq", "tau", "temperature")}
        speeds = self.speeds(self._sent_at, columns["q"], columns["dq"])
        status = Status.RUNNING if self.on else Status.IDLE
        return JointState(
            self.clock.now(), self._sent_at, columns["q"], speeds, columns["tau"], nan, columns["temperature"], status,
            "holding" if self.on and self._target.braking else "",
        )  # fmt: skip
