"""Which part of a motion is recorded, and what its log says of readings that did not come."""

from __future__ import annotations

from dataclasses import dataclass

from logs.recording import WARN, Recording
from sim.joint_state import JointState


@dataclass(frozen=True)
class Window:
    """What part of a motion is recorded: samples first to last (excluded), into `recording`."""

    recording: Recording
    first: int
    last: int


def mark_gap(record: Recording, before: JointState, state: JointState, rate: float) -> None:
    """Readings that did not come, by the device's clock, as an event in the log; how long a gap may be the monitor says."""
    missing = round((state.t_device - before.t_device) * rate) - 1
    if missing > 0:
        gap = 1e3 * (state.t_device - before.t_device)
        record.event(WARN, "gap", f"{missing} readings are missing: {gap:.0f} ms between two", state.t_device)
