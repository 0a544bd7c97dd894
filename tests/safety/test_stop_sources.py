"""Every source of stop requests is heard, and a second request does not cancel the first."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from safety.stop_sources import Heartbeat, StopSignals, first_reason
from sim.clock import SimulatedClock


@pytest.mark.parametrize(
    ("number", "message"), [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP")]
)
def test_signals_ask_for_a_stop_and_do_nothing_else(number: int, message: str) -> None:
    before = signal.getsignal(number)
    with StopSignals() as signals:
        assert signals.reason() is None
        os.kill(os.getpid(), number)
        assert signals.interrupted == (number == signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), number)
        assert message in str(signals.reason())
        assert signals.interrupted
    assert signal.getsignal(number) is before


def test_in_another_thread_signals_stay_as_they_are() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen: list[object] = []

    def work() -> None:
        with StopSignals() as signals:
            seen.extend((signals.reason(), signal.getsignal(signal.SIGINT)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [None, before]


def test_a_heartbeat_that_was_missed_once_stays_missed() -> None:
    clock = SimulatedClock()
    heart = Heartbeat("the key was released", 0.15, clock)
    for k in range(1, 20):
        clock.sleep_until(0.149 * k)
        assert heart.reason() is None
        heart.beat()
    clock.sleep_until(clock.now() + 0.1501)
    assert heart.reason() == "the key was released"
    heart.beat()
    assert heart.reason() == "the key was released"


def test_a_clock_that_says_nothing_is_a_missed_beat() -> None:
    clock = SimulatedClock()
    heart = Heartbeat("gone", 0.15, clock)
    clock.sleep_until(float("inf"))
    heart.beat()
    assert heart.reason() == "gone"


def test_the_first_source_with_a_reason_counts() -> None:
    assert first_reason(lambda: None, lambda: "b", lambda: "c")() == "b"
    assert first_reason(lambda: None)() is None
    assert first_reason()() is None
