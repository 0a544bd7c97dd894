"""Does the planned traffic fit on the wire? Worst-case bits of every frame, stuffing included, against the bit rate."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.can_servo.drive import Drive
from sim.errors import ConfigError

INTERFRAME = 3


def frame_bits(extended: bool, data_bytes: int) -> tuple[int, int]:
    """(fewest, most) bits of a data frame on the wire: 44 + 8 n or 64 + 8 n, 3 between frames, a stuffed bit each 4 after the first.

    Stuffed are start of frame to the checksum: 34 + 8 n or 54 + 8 n bits, so at most (that - 1) // 4 more (see Davis et al.,
    Controller Area Network (CAN) schedulability analysis: refuted, revisited and revised, 2007).
    """
    stuffable = (54 if extended else 34) + 8 * data_bytes
    plain = stuffable + 10 + INTERFRAME
    return plain, plain + (stuffable - 1) // 4


@dataclass(frozen=True, slots=True)
class Budget:
    """Load of a bus: frames a second, parts of the bit rate without and with worst stuffing, and the highest rate that fits, Hz."""

    frames_per_second: float
    load: float
    load_worst: float
    rate_max: float


def bus_budget(drives: Iterable[Drive], rate: float, bitrate: int, load_max: float) -> Budget:
    """The load of one control cycle of all drives at `rate` Hz, and of their unasked frames."""
    drives = list(drives)
    sizes = [frame_bits(*frame) for drive in drives for frame in drive.cycle]
    beats = [(drive.beats, frame_bits(drive.extended, 8)) for drive in drives]
    plain, worst = (sum(s[i] for s in sizes) for i in (0, 1))
    other_plain, other_worst = (sum(b * s[i] for b, s in beats) for i in (0, 1))
    return Budget(
        rate * len(sizes) + sum(b for b, _ in beats), (rate * plain + other_plain) / bitrate, (rate * worst + other_worst) / bitrate,
        (load_max * bitrate - other_worst) / worst,
    )  # fmt: skip


def require_budget(drives: Iterable[Drive], rate: float, bitrate: int, load_max: float, where: str) -> Budget:
    """The budget, or a ConfigError that names the highest rate that fits."""
    budget = bus_budget(drives, rate, bitrate, load_max)
    if not budget.load_worst <= load_max:
        raise ConfigError(
            f"{where}: rate = {rate:g} Hz needs {budget.frames_per_second:.0f} frames a second, {100 * budget.load_worst:.0f} % of "
            f"{bitrate} bit/s in the worst case; at most {100 * load_max:.0f} % may be planned: use {math.floor(budget.rate_max)} Hz or less, "
            "a second bus, or a higher bit rate"
        )
    return budget
