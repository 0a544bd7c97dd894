"""What goes out on the bus and what comes back while drives are commanded: one frame a drive at each instant of a schedule."""

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

BRAKING = 4.0  # rad/s^2 of the fastest joint, the others keep their share: what every arm of this kind can brake with
STANDSTILL = 0.05  # rad/s


class Stream:
    """From the bus that was opened to the bus that is let go. Every method raises a DeviceError for what a healthy bus does not carry.

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
        # A drive that sends by its own clock is waited for; one that answers gets another request at the next instant.
        self._patience = PERIODS_MAX / self.rate
        self._next = self._sent_at = clock.now()
        self._target = Target(drives, feedforward, BRAKING, PERIODS_MAX / self.rate)

    @property
    def holding(self) -> bool:
        """Whether the drives carry the arm and hear what they are sent."""
        return self.on and not self.link.failed

    def read(self) -> JointState:
        """All joints' answers to the last command; without one, the drives get a request at the next instant of the schedule."""
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
        """One target at the next instant of the schedule; the positions after quantisation, rad."""
        sent = self._target.follow(q, dq, tau, self.clock.now())
        self._transmit(range(len(self.drives)))
        return sent

    def admitted(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> list[np.ndarray]:
        """A command as arrays of its own: finite, and after a pause where the arm is held, or stands while the drives are off."""
        # copies that can be written to: compiled dynamics would be compiled again, a second and more, for arrays that cannot
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
        """The drives on, one joint after the other, each holding where it stands."""
        self._requested = False
        self._target.stand(self.read().q, self.clock.now())
        switch_on(self.link, self.joints, self.clock, self._target.frames)
        self.on, self._requested, self._sent_at = True, False, self.clock.now()
        self._next = self._sent_at + 1.0 / self.rate

    def take_over(self, state: JointState) -> None:
        """Command drives that somebody else has switched on, from where they stood last."""
        self._target.follow(state.q, state.dq, np.zeros(len(self.drives)), self.clock.now())
        self.on = True

    def hold(self) -> None:
        """One braking or holding frame to each drive at once, whatever else is on the bus; answers sorted in."""
        self._sent_at = self.clock.now()
        self._target.brake(self._sent_at)
        fault: DeviceError | None = None
        try:
            self.joints.drain()
        except DeviceError as error:  # a node that babbles, a second host: the arm gets its frames first
            fault = error
        self.joints.expect(range(len(self.drives)))
        self.link.send(self._target.frames)
        if fault is not None:
            raise fault
        self.joints.collect(self.clock.now() + 0.5 / self.rate)

    def neglected(self) -> bool:
        """Whether the arm brakes already, or nobody has commanded for half the time of the watchdogs."""
        return self._target.braking or self.clock.now() - self._sent_at > self.options.watchdog / 2

    def stands(self) -> bool:
        """Whether every joint was last read at a standstill."""
        return all(r is not None and abs(r.dq) < STANDSTILL for r in self.joints.readings)

    def _transmit(self, joints: Iterable[int]) -> None:
        """The present target to these joints, or only a question while the drives are off, at the next instant of the schedule."""
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
