"""Listen to what drives answer to another program: frames are received, and none is ever sent."""

from __future__ import annotations

from collections.abc import Sequence

import can
import numpy as np

from drivers.can_servo.drive import Drive, DriveReading
from drivers.can_servo.link import Link
from drivers.can_servo.opening import SHARED
from drivers.can_servo.senders import Senders
from drivers.can_servo.speed import Speeds
from sim.can_wiring import CanOptions
from sim.clock import Clock
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState, Status

PATIENCE = 5.0  # s without a complete round of answers


class Listener:
    """`read` returns one state per round of answers, in which every joint has sent once.

    If a joint sends again before all have sent, an answer was lost: the round is dropped and a new one begins, so that a state never
    mixes two rounds. Answers of drives that are off, or whose heartbeat is missing, are ignored: they carry no torque, and replies to
    register requests look like them.
    """

    def __init__(self, drives: Sequence[Drive], link: Link, clock: Clock, rate: float) -> None:
        self.drives, self.link, self.clock = drives, link, clock
        self.lost, self.patience = 0, PATIENCE
        self.last: JointState | None = None
        self._sender = Senders(drives)
        self._speeds = Speeds([(d.q_step, d.dq_step) for d in drives], rate)
        self._round: dict[int, DriveReading] = {}
        self._began = 0.0

    def read(self) -> JointState:
        """The next round, at the instant of its first answer; DeviceError after `patience` s without one."""
        end = self.clock.now() + self.patience
        while (message := self.link.receive(end)) is not None:
            if self._take(message) and len(self._round) == len(self.drives):
                return self._state()
        received = ", ".join(self.drives[j].servo.joint for j in self._round) or "none of its drives"
        raise DeviceError(
            f"{self.link.where}: in {self.patience:g} s not all drives have sent an answer, received: {received}; drives answer only the program "
            "that commands them, so start that program first, and check that this one is on the same bus"
        )

    def _take(self, message: can.Message) -> bool:
        """Whether the frame is an answer of a drive that is on."""
        j = self._sender(message)
        if j is None:
            return False
        reading = self.drives[j].decode(message, self.clock.now())
        if reading is None or not self.drives[j].says(reading, True):
            return False
        if j in self._round:
            self.lost += 1
            self._round = {}
        if not self._round:
            # the instant at which the frame was on the wire, where the interface reports it
            self._began = message.timestamp or self.clock.now()
        self._round[j] = reading
        return True

    def _state(self) -> JointState:
        readings, self._round = [self._round[j] for j in range(len(self.drives))], {}
        q, dq, tau, temperature = (np.array([getattr(r, key) for r in readings]) for key in ("q", "dq", "tau", "temperature"))
        speeds = self._speeds(self._began, q, dq)
        wrong = "; ".join(f"{d.name}: {r.error}" for d, r in zip(self.drives, readings, strict=True) if r.error)
        status = Status.FAULT if wrong else Status.RUNNING
        self.last = JointState(
            self.clock.now(), self._began, q, speeds, tau, np.full(len(q), np.nan), temperature, status, wrong
        )
        return self.last


def inaudible(options: CanOptions) -> str:
    """Why listening is impossible: a bus that serves one program only, or drives that must be asked for their ranges; else empty."""
    if options.interface not in SHARED:
        return (
            f"{options.interface} {options.channel}: this adapter belongs to the program that opened it, so no second one can listen; reach "
            "the bus through socketcan or socketcand (a serial adapter through slcand), or record a log and watch that"
        )
    silent = [s.joint for s in options.servos if s.ranges is None and s.protocol != "odrive"]
    if silent:
        return (
            f"{', '.join(silent)}: a listener cannot ask a drive for its ranges; state them in its servo, as `calib servo "
            "CELL --json` reports them while no program commands the drives"
        )
    return ""


def require_audible(options: CanOptions) -> None:
    """ConfigError if the bus is `inaudible`."""
    if reason := inaudible(options):
        raise ConfigError(reason)
