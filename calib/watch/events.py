"""The events that a watcher reports, each either about the arm or about the readings."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any

from calib.terminal.quantity import rounded
from logs.normal import INTERVAL
from logs.recording import ERROR, INFO, WARN

SCHEMA = "watch-event/1"


class Kind(enum.Enum):
    """What happened; the value is the name in /events and in JSON lines."""

    LOAD_CHANGED = "load_changed"
    PAYLOAD_ATTACHED = "payload_attached"
    PAYLOAD_CHANGED = "payload_changed"
    PAYLOAD_REMOVED = "payload_removed"
    DECLARED_PAYLOAD_WRONG = "declared_payload_wrong"
    UNEXPECTED_CONTACT = "unexpected_contact"
    CONTACT_ENDED = "contact_ended"
    FRICTION_DRIFT = "friction_drift"
    MODEL_INVALID = "model_invalid"
    BAD_READING = "bad_reading"
    GAP = "gap"
    FROZEN = "frozen"
    WRONG_ARM = "wrong_arm"
    WRONG_RATE = "wrong_rate"
    UNWATCHABLE = "unwatchable"


ABOUT_INPUT = frozenset({Kind.BAD_READING, Kind.GAP, Kind.FROZEN, Kind.WRONG_ARM, Kind.WRONG_RATE, Kind.UNWATCHABLE})
# these need attention; ordinary work produces INFO only
CONCERNS = frozenset(
    {
        Kind.DECLARED_PAYLOAD_WRONG, Kind.UNEXPECTED_CONTACT, Kind.FRICTION_DRIFT, Kind.MODEL_INVALID, Kind.WRONG_ARM,
        Kind.UNWATCHABLE,
    }
)  # fmt: skip
_ERRORS = frozenset({Kind.MODEL_INVALID, Kind.WRONG_ARM})


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its standard deviation and unit; printed with its 95 % interval, both to the interval's second digit."""

    value: float
    std: float
    unit: str

    def __str__(self) -> str:
        return rounded(self.value, INTERVAL * self.std, self.unit)


@dataclass(frozen=True, slots=True)
class WatchEvent:
    """One event: when it was known, between which instants it began (s, device clock), its size and its joint."""

    kind: Kind
    t: float
    began: tuple[float, float]
    message: str
    size: dict[str, Quantity] = field(default_factory=dict)
    joint: str | None = None

    @property
    def about(self) -> str:
        """ "arm" or "input"."""
        return "input" if self.kind in ABOUT_INPUT else "arm"

    @property
    def level(self) -> int:
        """Level of rcl_interfaces/msg/Log."""
        if self.kind in _ERRORS:
            return ERROR
        return WARN if self.kind in CONCERNS or self.about == "input" else INFO

    def as_dict(self) -> dict[str, Any]:
        """The event for JSON lines; `interval` is 95 %."""
        return {
            "schema": SCHEMA, "event": self.kind.value, "about": self.about, "t": self.t, "began": list(self.began), "joint": self.joint,
            "size": {
                name: {"value": e.value, "std": e.std, "interval": [e.value - INTERVAL * e.std, e.value + INTERVAL * e.std], "unit": e.unit}
                for name, e in self.size.items()
            },
            "message": self.message,
        }  # fmt: skip
