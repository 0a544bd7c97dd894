"""A stall of the emulator does not count as silence of its host."""

from __future__ import annotations

import pytest

from sim.emulated.can import STALL, BusClock


def test_what_was_not_done_in_time_is_time_that_did_not_pass() -> None:
    wall = iter([100.0, 100.001, 100.002, 100.502, 100.503])
    clock = BusClock(lambda: next(wall))
    times = [clock.now() for _ in range(4)]
    assert times == pytest.approx([100.001, 100.002, 100.002 + STALL, 100.003 + STALL])
