"""The recorded part of a motion, and the log entry for missing readings."""

from __future__ import annotations

from dataclasses import dataclass

from logs.recording import WARN, Recording
from sim.joint_state import JointState


@dataclass(frozen=True)
class Window:
    """The part of a motion that goes into `recording`: samples first to last, last excluded."""

    recording: Recording
    first: int
    last: int


def mark_gap(record: Recording, before: JointState, state: JointState, rate: float) -> None:
    """Log readings that are missing by the device's clock as an event; the monitor limits the length of a gap."""
    missing = round((state.t_device - before.t_device) * rate) - 1
    if missing > 0:
        gap = 1e3 * (state.t_device - before.t_device)
        record.event(WARN, "gap", f"{missing} readings are missing: {gap:.0f} ms between two readings", state.t_device)
