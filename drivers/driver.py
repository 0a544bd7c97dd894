"""The driver interface, the same for real, emulated and recorded arms."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np

from sim.arm import Arm
from sim.clock import Clock
from sim.errors import CalibError, ConfigError, DeviceError
from sim.joint_state import JointState, Status


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What a device reports about itself on connecting; recorded with every log.

    payload_mass (kg) and payload_com (3,) (m, last link's frame) are what the device assumes; None if it does not report them.
    gravity (3,) m/s^2 in the base frame, from the mounting that the device assumes; None if it does not report it.
    """

    model: str
    serial: str
    firmware: str
    rate: float
    payload_mass: float | None = None
    payload_com: tuple[float, float, float] | None = None
    gravity: tuple[float, float, float] | None = None
    torque_source: str = "effort"
    extra: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Check:
    """One preflight check and its result; ok is None if the device cannot answer it.

    detail states what was found, with values; remedy states what the operator does if ok is False. assume is the entry of a cell file
    (sim.assumptions) that waives a failure; empty if nothing may waive it.
    """

    name: str
    ok: bool | None
    detail: str
    remedy: str = ""
    assume: str = ""


@dataclass(frozen=True, slots=True)
class DeviceStop:
    """How the device brakes by itself when commanded to stop or when the link is lost; `safety.clear` verifies the room for it.

    It may continue at the last speed for `reaction` s. Then every joint decelerates at `deceleration` rad/s^2; with `proportional`
    the fastest joint does, and the others keep their ratio to its speed. The default is slower than any device that we know of.
    """

    reaction: float = 0.1
    deceleration: float = 4.0
    proportional: bool = False

    def __post_init__(self) -> None:
        if not (
            math.isfinite(self.reaction) and self.reaction >= 0 and math.isfinite(self.deceleration) and self.deceleration > 0
        ):
            raise ConfigError(f"{self}: needs a finite reaction >= 0 and a finite deceleration > 0; state those of the device")


class Driver(ABC):
    """Driver of one arm: connect, read, send, stop, close. As a context manager it connects and closes.

    Every method returns or raises within a bounded time. A value older than three periods, or than `gap_max` s if that is longer, is a
    DeviceError and never returned as new. Only `safety.Guard` calls `send`.

    rate: control and sampling rate, Hz. clock: host clock of `JointState.t` (simulated for the mock). gap_max: s, for which every stop
    has room. sole: another commanding program must be ended before `halt`, because its commands would continue. ready: statuses in
    which `engage` may be called. control: what `connect` does to the device beyond listening; empty if nothing.
    """

    arm: Arm
    rate: float
    clock: Clock
    device_stop: DeviceStop = DeviceStop()
    gap_max: float = 0.0
    control: str = ""
    sole: bool = False
    ready: frozenset[Status] = frozenset({Status.RUNNING})

    @abstractmethod
    def connect(self) -> DeviceInfo:
        """Open the connection without moving anything; DeviceError with the remedy if it cannot be opened."""

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Open the connection for reading only, while another program moves the arm: nothing is sent that could change the device.

        `send` is refused until `connect`. patience: longest wait of `read`, s; None for the driver's default. A driver whose device
        sends by itself may use its own. DeviceError if a device of this kind cannot be read without a request.
        """
        raise DeviceError(
            f"{self.arm.name}: its devices answer only the program that commands them, so a second program cannot listen; record a log "
            "and watch that"
        )

    def beside(self) -> str:
        """Why a second driver of the same cell cannot `listen` beside this one and `halt` its device; empty if it can."""
        return f"only one program can read a device of driver {type(self).__name__}"

    def halt(self) -> None:
        """After `listen`: bring the device to rest, whatever commanded it before; `close` then refuses if the arm must still be held.

        DeviceError if this is not possible. Only the monitor process calls it; with `sole`, it first ends the commanding program.
        """
        raise DeviceError(f"{self.arm.name}: {self.beside()}, so no second program can stop it")

    def inspect(self) -> DeviceInfo:
        """Open the connection for checks: nothing moves and no control is taken. Same as `connect` if that takes none."""
        return self.connect()

    def declared_payload(self) -> tuple[float, tuple[float, float, float]] | None:
        """Mass (kg) and centre of mass (m, last link's frame) of the payload that the device currently assumes; None if not reported."""
        return None

    @abstractmethod
    def read(self) -> JointState:
        """Next sample, in order and each exactly once; waits at most three periods, or `gap_max` s if that is longer."""

    @abstractmethod
    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Command position (n,) rad with speed (n,) rad/s and feed-forward torque (n,) N m, NaN-free.

        Return the position actually sent, (n,) rad, after the device's own quantisation. Never clamps: a command that the device
        cannot represent is a DeviceError.
        """

    @abstractmethod
    def stop(self) -> None:
        """Request the device's own bounded stop; safe to call at any time and more than once."""

    @abstractmethod
    def close(self) -> None:
        """Leave the device at rest and release it; safe to call more than once."""

    def engage(self) -> str:
        """Make the device ready to follow commands from the current pose, for example by switching its drives on; nothing moves.

        Called once before the first `send`. Return a sentence for the log on what was done; empty if nothing was needed.
        """
        return ""

    def checks(self) -> list[Check]:
        """Checks of this kind of device before motion, beyond `drivers.preflight`; needs a connection, moves nothing."""
        return []

    def gravity(self, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> list[Check]:
        """Checks of which arm of its kind this is, from the holding torque tau (K, n) N m in poses q (K, n) rad.

        friction (K, n) N m bounds the friction that tau may still contain.
        """
        return []

    def __enter__(self) -> Self:
        self.info = self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close; a refusal by `close` does not hide an earlier error."""
        try:
            self.close()
        except DeviceError as refusal:
            if not isinstance(error, CalibError):
                raise
            error.args = (f"{error}; besides, {refusal}", *error.args[1:])
