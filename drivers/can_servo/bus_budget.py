"""Bus load of the planned traffic: worst-case time of every frame, stuffing included, as a share of the time available."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.can_servo.drive import Drive
from sim.can_wiring import CanOptions
from sim.errors import ConfigError

INTERFRAME = 3
# CAN FD, ISO 11898-1: SOF, identifier, RRS, IDE, FDF, res, BRS before the switch (the extended head has SRR and 18 bits more); after it ESI, DLC,
# data, stuff count, checksum of 17 (up to 16 bytes) or 21 with a fixed stuffed bit each 4; then delimiters, acknowledgement, end of frame
FD_HEAD, FD_HEAD_EXTENDED, FD_TAIL = 17, 36, 10 + INTERFRAME


def frame_bits(extended: bool, data_bytes: int) -> tuple[int, int]:
    """(fewest, most) bits of a data frame of n bytes on the wire: 44 + 8 n, or 64 + 8 n if extended, 3 between frames, and stuff bits.

    From start of frame to checksum 34 + 8 n or 54 + 8 n bits are stuffed, which adds at most (that - 1) // 4 bits (see Davis et al.,
    Controller Area Network (CAN) schedulability analysis: refuted, revisited and revised, 2007).
    """
    stuffable = (54 if extended else 34) + 8 * data_bytes
    plain = stuffable + 10 + INTERFRAME
    return plain, plain + (stuffable - 1) // 4


def frame_time(extended: bool, data_bytes: int, bitrate: int, data_bitrate: int | None) -> tuple[float, float]:
    """(shortest, longest) time of a frame on the wire, s; if `data_bitrate` is given, of a CAN FD frame that switches to it."""
    if data_bitrate is None:
        fewest, most = frame_bits(extended, data_bytes)
        return fewest / bitrate, most / bitrate
    head, fast = FD_HEAD_EXTENDED if extended else FD_HEAD, 5 + 8 * data_bytes
    check = 4 + (17 if data_bytes <= 16 else 21)
    check += math.ceil(check / 4)
    shortest = (head + FD_TAIL) / bitrate + (fast + check) / data_bitrate
    return shortest, shortest + (head - 1) // 4 / bitrate + math.ceil(fast / 4) / data_bitrate


@dataclass(frozen=True, slots=True)
class Budget:
    """Load of a bus: frames per second, share of its time without and with worst stuffing, and the highest rate that fits, Hz."""

    frames_per_second: float
    load: float
    load_worst: float
    rate_max: float


def bus_budget(drives: Iterable[Drive], rate: float, options: CanOptions) -> Budget:
    """The load of the control cycle of all drives at `rate` Hz, and of the frames that they send unasked."""

    def times(drive: Drive, extended: bool, data_bytes: int) -> tuple[float, float]:
        return frame_time(extended, data_bytes, options.bitrate, options.data_bitrate if drive.servo.fd else None)

    drives = list(drives)
    cycle = [times(drive, *frame) for drive in drives for frame in drive.cycle]
    beats = [(drive.beats, times(drive, drive.extended, 8)) for drive in drives]
    plain, worst = (sum(t[i] for t in cycle) for i in (0, 1))
    other_plain, other_worst = (sum(b * t[i] for b, t in beats) for i in (0, 1))
    return Budget(
        rate * len(cycle) + sum(b for b, _ in beats), rate * plain + other_plain, rate * worst + other_worst,
        (options.bus_load_max - other_worst) / worst,
    )  # fmt: skip


def require_budget(drives: Iterable[Drive], rate: float, options: CanOptions, where: str) -> Budget:
    """The budget, or a ConfigError that names the highest rate that fits."""
    budget = bus_budget(drives, rate, options)
    if not budget.load_worst <= options.bus_load_max:
        raise ConfigError(
            f"{where}: rate = {rate:g} Hz needs {budget.frames_per_second:.0f} frames a second, {100 * budget.load_worst:.0f} % of "
            f"{bit_rates(options)} in the worst case; at most {100 * options.bus_load_max:.0f} % may be planned: use "
            f"{math.floor(budget.rate_max)} Hz or less, a second bus, or a higher bit rate"
        )
    return budget


def bit_rates(options: CanOptions) -> str:
    """The bit rates of a bus, as part of a sentence."""
    fast = f", data at {options.data_bitrate}" if options.data_bitrate else ""
    return f"{options.bitrate}{fast} bit/s"
