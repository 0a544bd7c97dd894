"""Which readings are returned after a pause of this computer, by what the driver is doing."""

from __future__ import annotations

import time
from collections import deque
from typing import cast

import pytest

from drivers.ur_rtde.frames_in_order import FramesInOrder
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.receiver import Frame, Receiver

PAUSE = 0.024  # s: 12 periods of 2 ms


class Waiting:
    """A receiver in which the frames of the last `seconds` s wait."""

    rate = 500.0

    def __init__(self, seconds: float) -> None:
        now, count = time.monotonic(), round(seconds * self.rate)
        self.frames = deque(
            Frame(now - (count - 1 - k) / self.rate, 0.0, {"timestamp": (100.0 + k / self.rate,)}) for k in range(count)
        )

    def next(self, _deadline: float) -> Frame | None:
        return self.frames.popleft() if self.frames else None

    @property
    def waiting(self) -> int:
        return len(self.frames)


def stamps_after(seconds: float, commanded: bool = False, listening: bool = False) -> tuple[list[float], int]:
    """Controller times of the readings returned when the frames of `seconds` s wait, and how many frames waited."""
    receiver = Waiting(seconds)
    count = receiver.waiting
    frames = FramesInOrder(cast(Receiver, receiver), UrOptions(host="127.0.0.2"), lambda _frame: True)
    frames.listening = listening
    if commanded:
        frames.set_moving(False)
    stamps = []
    while receiver.waiting:
        stamps.append(frames.next().t_device)
    return stamps, count


def test_a_short_pause_before_the_first_command_loses_no_reading() -> None:
    stamps, count = stamps_after(PAUSE / 2)
    assert len(stamps) == count


def test_a_long_pause_before_the_first_command_starts_again_from_new_readings() -> None:
    stamps, count = stamps_after(0.5)
    assert 0 < len(stamps) <= 4  # 3 periods
    assert stamps[-1] == pytest.approx(100.0 + (count - 1) / 500.0)


def test_after_a_command_at_rest_only_new_readings_are_returned() -> None:
    stamps, count = stamps_after(PAUSE, commanded=True)
    assert 0 < len(stamps) < count / 2


def test_a_listener_gets_every_reading() -> None:
    stamps, count = stamps_after(0.5, listening=True)
    assert len(stamps) == count
