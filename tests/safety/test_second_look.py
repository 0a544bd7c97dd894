"""The monitor process: when it requests a stop, and when it takes over from the guard."""

from __future__ import annotations

import numpy as np
import pytest

from safety.clear import ClearedTrajectory
from safety.collision import Clearance
from safety.coming_to_rest import STANDING_CYCLES
from safety.guard import STANDSTILL
from safety.monitor_link import silence_of
from safety.second_look import REST_AFTER, SLOWER_AFTER, Watch
from safety.signs import ENDED, HOLDS, STOPS, Sign
from safety.verified_samples import VerifiedSamples
from sim.arm import Arm
from sim.cell import Cell
from tests.safety.conftest import PERIOD, RATE, state_at

LATENCY = 0.01
SILENCE = silence_of(RATE, LATENCY)


@pytest.fixture
def watch(arm: Arm, cell: Cell, clearance: Clearance, tube: VerifiedSamples) -> Watch:
    return Watch(arm, cell, RATE, clearance, state_at(), LATENCY, tube)


class Seen:
    """A guard that drives `motion` as leg 0, and an arm that follows one period later."""

    def __init__(self, watch: Watch, motion: ClearedTrajectory) -> None:
        self.watch, self.motion = watch, motion
        self.i = 0

    def look(
        self,
        k: int,
        leg: int = 0,
        silent: float = 0.0,
        q: np.ndarray | None = None,
        at: np.ndarray | None = None,
        **changes: object,
    ) -> str | None:
        """The next reading, while the guard shows sample k."""
        self.i += 1
        row = min(max(k, 0), len(self.motion) - 1)
        command = self.motion.q[row] if q is None else q
        known = {
            "q": self.motion.q[max(row - 1, 0)] if at is None else at,
            "dq": self.motion.dq[max(row - 1, 0)],
            "tau": self.motion.tau_hat[row],
        }
        state = state_at(self.i, **(known | changes))
        return self.watch.look(state, self.i * PERIOD, Sign(self.i * PERIOD - silent, leg, k, command))

    def drive(self, count: int, first: int = 0) -> None:
        for k in range(first, first + count):
            assert self.look(k) is None
            assert self.watch.trip is None


@pytest.fixture
def seen(watch: Watch, motions: list[ClearedTrajectory]) -> Seen:
    return Seen(watch, motions[0])


def held(seen: Seen, k: int, count: int = 5) -> None:
    for _ in range(count):
        assert seen.look(HOLDS, q=seen.motion.q[k], dq=np.zeros(6)) is None


def test_a_whole_motion_held_before_and_after_is_fine(seen: Seen) -> None:
    held(seen, 0)
    seen.drive(len(seen.motion))
    for _ in range(5):
        assert seen.look(HOLDS, q=seen.motion.q[-1], dq=np.zeros(6)) is None
    assert seen.watch.trip is None


def test_samples_that_were_not_seen_are_fine_and_so_is_a_hold_at_an_end_that_was_not(seen: Seen) -> None:
    seen.drive(10)
    assert seen.look(12) is None
    held(seen, -1, 1)
    assert seen.watch.trip is None


def test_a_broken_rule_is_shown_and_the_guard_has_its_time(seen: Seen) -> None:
    seen.drive(300)
    assert seen.look(300, temperature=np.full(6, 90.0)) is None
    assert seen.watch.trip is not None
    assert "temperature" in seen.watch.trip
    while seen.i * PERIOD < 301 * PERIOD + SILENCE - 1.5 * PERIOD:
        assert seen.look(300) is None
    found = seen.look(300)
    assert found is not None
    assert "the guard did not stop" in found
    assert "temperature" in found


def test_a_guard_that_is_silent_loses_the_arm(seen: Seen) -> None:
    seen.drive(300)
    assert seen.look(300, silent=SILENCE * 0.999) is None
    found = seen.look(301, silent=SILENCE * 1.001)
    assert found is not None
    assert "the guard was silent" in found
    assert "the guard was silent" in str(seen.look(302, silent=np.nan))


def test_a_command_that_was_not_verified_is_a_reason_to_stop(seen: Seen) -> None:
    seen.drive(300)
    assert seen.look(300, q=seen.motion.q[300] + np.array([0, 0, 0, 0, 0, 1e-12])) is None
    assert seen.watch.trip == "command 300 of motion 0 is not one that was verified"


@pytest.mark.parametrize("k", [10_000, -7])
def test_a_sample_that_there_is_not_is_a_reason_to_stop(seen: Seen, k: int) -> None:
    seen.drive(300)
    seen.look(k)
    assert seen.watch.trip is not None
    assert "is not one that was verified" in seen.watch.trip


@pytest.mark.parametrize("k", [298, 300 + int(np.ceil(SILENCE * RATE)) + 1, 700])
def test_samples_out_of_order_are_a_reason_to_stop(seen: Seen, k: int) -> None:
    seen.drive(300)
    seen.look(k)
    assert seen.watch.trip == f"command {k} of motion 0 comes after 299"


def test_a_motion_that_begins_in_its_middle_is_a_reason_to_stop(seen: Seen) -> None:
    held(seen, 0)
    seen.look(400, q=seen.motion.q[400])
    assert seen.watch.trip == "command 400 of motion 0 comes after -1"


def test_the_next_motion_begins_anew(seen: Seen, motions: list[ClearedTrajectory]) -> None:
    seen.drive(len(seen.motion))
    seen.motion = motions[1]
    for k in range(3):
        assert seen.look(k, leg=1) is None
    assert seen.watch.trip is None


def test_a_command_that_changes_while_the_guard_holds_is_a_reason_to_stop(seen: Seen) -> None:
    held(seen, 0)
    seen.look(HOLDS, q=seen.motion.q[0] + 1e-9)
    assert seen.watch.trip == "the command changes while the guard holds the arm"


def test_readings_that_end_are_a_reason_to_stop(seen: Seen, watch: Watch) -> None:
    seen.drive(300)
    now = (seen.i + 1) * PERIOD
    watch.deaf = "the cable is out"
    assert watch.look(None, now, Sign(now, 0, 300, seen.motion.q[300])) is None
    assert watch.trip == "the monitor process receives no more readings: the cable is out"


def stopping(watch: Watch, since: float, speed: float, k: int = STOPS) -> str | None:
    return watch.look(state_at(0, dq=np.full(6, speed)), 10.0 + since, Sign(0.0, 0, k, np.zeros(6)))


@pytest.mark.parametrize("k", [STOPS, ENDED])
def test_a_stop_must_slow_the_arm_down_and_end(watch: Watch, k: int) -> None:
    assert stopping(watch, 0.0, 0.5, k) is None
    assert stopping(watch, SLOWER_AFTER - 0.01, 0.6, k) is None
    assert stopping(watch, SLOWER_AFTER + 0.01, 0.49, k) is None
    assert not watch.at_rest
    assert "no slower" in str(stopping(watch, SLOWER_AFTER + 0.02, 0.5, k))
    assert stopping(watch, REST_AFTER - 0.01, 0.1, k) is None
    assert "does not stand" in str(stopping(watch, REST_AFTER + 0.01, 0.1, k))
    for cycle in range(STANDING_CYCLES):
        assert not watch.at_rest
        assert stopping(watch, REST_AFTER + 0.02 + cycle * PERIOD, 0.0, k) is None
    assert watch.at_rest
    assert stopping(watch, REST_AFTER + 9.0, 0.0, k) is None


def test_a_speed_that_is_no_number_is_no_rest(watch: Watch) -> None:
    assert stopping(watch, 0.0, np.nan) is None
    assert not watch.at_rest
    assert "no slower" in str(stopping(watch, SLOWER_AFTER + 0.01, np.nan))


def test_who_hears_nothing_of_a_stop_does_not_wait_for_ever(watch: Watch, arm: Arm) -> None:
    sign = Sign(0.0, 0, STOPS, np.zeros(6))
    assert watch.look(None, 10.0, sign) is None
    assert watch.look(None, 10.0 + SLOWER_AFTER - 0.01, sign) is None
    assert "no slower" in str(watch.look(None, 10.0 + SLOWER_AFTER + 0.01, sign))


def test_standing_is_what_the_guard_calls_it(watch: Watch, arm: Arm) -> None:
    noise = STANDSTILL + 8 * arm.sensors.velocity_noise[0]
    stopping(watch, 0.0, noise * 1.001)
    assert not watch.at_rest
    for cycle in range(STANDING_CYCLES):
        stopping(watch, 0.01 + cycle * PERIOD, noise * 0.999)
    assert watch.at_rest


def test_an_arm_that_turns_round_does_not_stand(watch: Watch) -> None:
    assert stopping(watch, 0.0, 0.5) is None
    assert stopping(watch, 0.01, 0.0) is None
    assert stopping(watch, SLOWER_AFTER + 0.01, 0.4) is None
    assert "no slower" in str(stopping(watch, SLOWER_AFTER + 0.02, 3.0))


def test_either_process_may_be_silent_as_long_as_a_reading_may_be_late() -> None:
    assert silence_of(500.0, 0.0) == pytest.approx(3.5 / 500)
    assert silence_of(500.0, 0.04) == pytest.approx(0.042)


def moved(seen: Seen, k: int, at: np.ndarray) -> dict[str, np.ndarray]:
    return {"at": at, "dq": seen.motion.dq[k - 1] + np.array([0.5, 0, 0, 0, 0, 0])}


def test_an_arm_that_leaves_its_tube_is_seen_without_the_guard(seen: Seen) -> None:
    seen.drive(300)
    off = np.zeros(6)
    for k in range(300, 700):
        off[0] += 0.5 * PERIOD
        at = seen.motion.q[k - 1] + off
        assert seen.look(k, leg=0, silent=0.0, q=seen.motion.q[k], **moved(seen, k, at)) is None
        if seen.watch.trip is not None:
            break
    assert seen.watch.trip is not None
    assert "j1: following error" in seen.watch.trip
    assert off[0] < seen.motion.room.max() + 0.01


def test_one_joint_that_moves_is_no_rest(watch: Watch) -> None:
    moving = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    assert watch.look(state_at(0, dq=moving), 10.0, Sign(0.0, 0, STOPS, np.zeros(6))) is None
    assert not watch.at_rest
