"""The one interface to an arm, whatever is behind it."""

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
    """What a device says of itself on connecting; recorded with every log.

    payload_mass (kg) and payload_com (3,) (m, last link's frame) are what the device assumes; None where it does not report them.
    gravity (3,) m/s^2 in the base frame, from the mounting the device assumes; None where it does not report it.
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
    """One question of the preflight and its answer; ok is None where the device cannot answer it.

    detail says what was found, with values; remedy what the operator does where the answer is no. assume is what a cell file may state
    (sim.assumptions) so that the answer no is passed over, empty where it never is.
    """

    name: str
    ok: bool | None
    detail: str
    remedy: str = ""
    assume: str = ""


@dataclass(frozen=True, slots=True)
class DeviceStop:
    """How the device brakes on its own when commanded to stop or when the link is lost; `safety.clear` proves room for it.

    reaction s: for so long it may go on at the last speed; deceleration rad/s^2 after that, of every joint, or with `proportional`
    of the fastest joint while the others keep their share of its speed. The default is slower than any device that we know of.
    """

    reaction: float = 0.1
    deceleration: float = 4.0
    proportional: bool = False

    def __post_init__(self) -> None:
        if not (
            math.isfinite(self.reaction) and self.reaction >= 0 and math.isfinite(self.deceleration) and self.deceleration > 0
        ):
            raise ConfigError(
                f"{self}: reaction is not negative, deceleration is above zero, both finite; state the device's own"
            )


class Driver(ABC):
    """connect, read, send, stop, close; a context manager that connects and closes.

    `rate` is the control and sampling rate, Hz; `clock` is the host clock on which `JointState.t` stands (the mock's is
    simulated). Only `safety.Guard` calls `send`. Every method returns or raises within a bounded time; a value that is older
    than three periods, or than `gap_max` s where that is longer, is never returned as new: that is a DeviceError; every stop has room for
    `gap_max`. `sole`: whoever else commands must be ended before `halt`, for its commands would go on. `ready` are the conditions in which `engage` may be called. `control` says what `connect` does to the device beyond
    listening, empty where nothing.
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
        """Open the connection without moving anything; DeviceError with the remedy where it cannot be opened."""

    def listen(self, patience: float | None = None) -> DeviceInfo:
        """Open the connection only to read, while something else moves the arm: nothing is sent that could change the device.

        patience s: how long `read` waits at the most, the driver's own time where it is None; a driver whose device sends by itself may have
        its own.

        `send` stays refused until `connect`. DeviceError where a device of this kind cannot be read without a request.
        """
        raise DeviceError(
            f"{self.arm.name}: its devices answer only the program that commands them, so nobody can listen beside it; record a log "
            "and watch the log"
        )

    def beside(self) -> str:
        """Why a second driver of the same cell cannot `listen` beside this one and `halt` its device; empty where it can."""
        return f"a device of driver {type(self).__name__} is heard by one program only"

    def halt(self) -> None:
        """After `listen`: bring the device to rest, whatever commanded it before; `close` then refuses where it must be held on.

        DeviceError where this is not possible. Only the monitor process calls it, when nobody else commands any more.
        """
        raise DeviceError(f"{self.arm.name}: {self.beside()}, so nobody can stop it beside that program")

    def inspect(self) -> DeviceInfo:
        """Open the connection for checks: nothing moves and no control is taken. `connect` where that takes none."""
        return self.connect()

    def declared_payload(self) -> tuple[float, tuple[float, float, float]] | None:
        """Mass kg and centre of mass m (last link's frame) that the device now assumes as payload; None where it does not report it."""
        return None

    @abstractmethod
    def read(self) -> JointState:
        """The next sample, in order and each one once; waits for it for at most three periods, or `gap_max` s."""

    @abstractmethod
    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Command position (n,) rad with speed (n,) rad/s and feed-forward torque (n,) N m, NaN-free.

        Returns the position that was really sent, (n,) rad, after the device's own quantisation. Never clamps: a command that
        the device cannot represent is a DeviceError.
        """

    @abstractmethod
    def stop(self) -> None:
        """Ask the device for its own bounded stop; safe to call at any time and more than once."""

    @abstractmethod
    def close(self) -> None:
        """Leave the device at rest and release it; safe to call more than once."""

    def engage(self) -> str:
        """Make the device follow commands from where the arm stands, such as switching its drives on; nothing moves.

        Called once before the first `send`. Returns what was done, a sentence for the log; empty where nothing was needed.
        """
        return ""

    def checks(self) -> list[Check]:
        """Checks of this kind of device before motion, beyond `drivers.preflight`; connected, and without moving it."""
        return []

    def gravity(self, q: np.ndarray, tau: np.ndarray, friction: np.ndarray) -> list[Check]:
        """What the torque tau (K, n) N m that holds the arm up in poses q (K, n) rad says of which of its kind it is.

        friction (K, n) N m is what may still be in it.
        """
        return []

    def __enter__(self) -> Self:
        self.info = self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close; what `close` refuses does not hide what went wrong before."""
        try:
            self.close()
        except DeviceError as refusal:
            if not isinstance(error, CalibError):
                raise
            error.args = (f"{error}; besides, {refusal}", *error.args[1:])
