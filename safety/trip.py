"""Why a motion was stopped: one sentence for people, numbers for machines."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from sim.errors import CalibError, SafetyStop
from sim.joint_state import JointState

STANDING = "standing"  # the stop of an arm that did not move


@dataclass(frozen=True)
class Trip:
    """A broken rule: joint (or None), quantity, its value and limit in `unit`, and what to check."""

    quantity: str
    value: float | str
    limit: float | str
    unit: str
    remedy: str
    joint: str | None = None

    def __str__(self) -> str:
        value, limit = (f"{x:.4g}" if isinstance(x, float) else x for x in (self.value, self.limit))
        unit = f" {self.unit}" if self.unit else ""
        rule = "" if limit == "none" else f", limit {limit}{unit}"
        return f"{self.joint + ': ' if self.joint else ''}{self.quantity} {value}{unit}{rule}; {self.remedy}"


@dataclass(frozen=True)
class Standstill:
    """How the arm came to rest: the stop, s from the reading that showed the fault to standstill, rad travelled by each joint.

    Angles count from the last good reading; predicted_angle rad is that of the commanded stop.
    """

    stop: str
    time: float
    angle: tuple[float, ...]
    predicted_angle: tuple[float, ...]
    at_rest: bool


class MotionStopped(SafetyStop):
    """Raised for a motion that was stopped on the way; holds the trip, how the arm came to rest, and the last samples."""

    def __init__(self, trip: Trip, t: float, standstill: Standstill, samples: tuple[JointState, ...], where: str) -> None:
        by = "" if standstill.stop == STANDING else f" ({standstill.stop})"
        stood = f"the arm stood still {standstill.time:.3f} s later"
        rest = stood if standstill.at_rest else "the arm was NOT seen to stand still: look at it"
        super().__init__(f"stopped in {where} at t={t:.3f} s; {rest}{by}: {trip}")
        self.trip, self.t, self.standstill, self.samples, self.where = trip, t, standstill, samples, where

    def __reduce__(self) -> tuple[type[MotionStopped], tuple[Any, ...], dict[str, Any]]:
        """With what was added to the sentence and noted since."""
        state = self.__dict__ | {"args": self.args}
        return MotionStopped, (self.trip, self.t, self.standstill, self.samples, self.where), state

    def record(self) -> dict[str, Any]:
        """The stop as JSON-ready values, without the samples."""
        trip, rest = self.trip, self.standstill
        return {
            "where": self.where, "t": self.t, "joint": trip.joint, "quantity": trip.quantity, "value": trip.value,
            "limit": trip.limit, "unit": trip.unit, "stop": rest.stop, "stop_time": rest.time, "stop_angle": list(rest.angle),
            "at_rest": rest.at_rest,
        }  # fmt: skip


@dataclass
class LastSamples:
    """The last `most` readings, oldest first."""

    most: int = 50
    states: list[JointState] = field(default_factory=list)

    def add(self, state: JointState) -> None:
        """Keep one more reading; old ones are dropped."""
        self.states.append(state)
        if len(self.states) > 2 * self.most:
            del self.states[: -self.most]

    def latest(self) -> tuple[JointState, ...]:
        """The last `most` readings."""
        return tuple(self.states[-self.most :])


def trip_of(error: BaseException) -> Trip:
    if isinstance(error, CalibError):
        return Trip("refused or failed:", str(error), "none", "", "see the cause")
    return Trip(f"{type(error).__name__}:", str(error) or "raised", "none", "", "this is a fault of the program: report it")
