"""The guard's side of the monitor process: handing over a stage, showing every command, and when the guard stops."""

from __future__ import annotations

import threading
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from safety.clear import ClearedTrajectory
from safety.collision import Clearance
from safety.guard import Guard
from safety.monitor import Monitor
from safety.monitor_link import ANSWER_TIME, MonitorLink, read, seen, write
from safety.signs import ENDED, HOLDS, Signs
from safety.trip import MotionStopped
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from tests.safety.conftest import CONTEXT
from tests.safety.perfect import PerfectDriver

RATE = 50.0


def answering(talk: Connection, answers: list[object]) -> tuple[threading.Thread, list[object]]:
    """A thread that plays the other process, with one answer to each message; and the messages that it got."""
    got: list[object] = []

    def run() -> None:
        for answer in answers:
            got.append(read(talk))
            write(talk, answer)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, got


def test_a_stage_is_handed_over_and_its_file_does_not_stay(
    cleared: ClearedTrajectory, talk: tuple[Connection, Connection], tmp_path: Path
) -> None:
    link = MonitorLink(Signs(6, CONTEXT), talk[0])
    thread, got = answering(talk[1], [True])
    link.begin([cleared, cleared], RATE, 0.01, tmp_path)
    thread.join()
    assert got == [{"file": str(tmp_path / "tube.npy"), "counts": [len(cleared)] * 2, "rate": RATE, "latency": 0.01}]
    assert list(tmp_path.iterdir()) == []
    write(talk[1], {"cycles": 7})
    assert link.end() == {"cycles": 7}


@pytest.mark.parametrize("answer", ["the approval is for another cell", None])
def test_a_monitor_process_that_refuses_or_has_ended_is_a_refusal(
    cleared: ClearedTrajectory, talk: tuple[Connection, Connection], tmp_path: Path, answer: str | None
) -> None:
    link = MonitorLink(Signs(6, CONTEXT), talk[0])
    if answer is None:
        talk[1].close()
    else:
        write(talk[1], answer)
    with pytest.raises(SafetyStop, match="another cell" if answer else "it has ended"):
        link.begin([cleared], RATE, 0.01, tmp_path)


def test_a_monitor_process_that_does_not_answer_is_a_refusal(
    cleared: ClearedTrajectory, talk: tuple[Connection, Connection], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ANSWER_TIME > 0
    monkeypatch.setattr("safety.monitor_link.ANSWER_TIME", 0.01)
    with pytest.raises(SafetyStop, match="no answer in"):
        MonitorLink(Signs(6, CONTEXT), talk[0]).begin([cleared], RATE, 0.01, tmp_path)


class At:
    """A clock that a test sets."""

    now = 5.0

    def __call__(self) -> float:
        return self.now


def test_what_a_monitor_process_says_before_it_sees_the_arm_is_reported(
    cleared: ClearedTrajectory, talk: tuple[Connection, Connection], driver: PerfectDriver, arm: Arm, cell: Cell,
    clearance: Clearance, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr("safety.monitor_link.SEEN_TIME", 0.1)
    link = MonitorLink(Signs(6, CONTEXT), talk[0])
    for said, end in (("no RTDE at robot", False), (None, True)):
        if end:
            talk[1].close()
        else:
            write(talk[1], said)
        with (
            pytest.raises(SafetyStop, match="it has ended" if end else "it says: no RTDE at robot"),
            seen(link, lambda sent: Guard(driver, arm, cell, clearance, sent=sent)),
        ):
            raise AssertionError("the guard was not seen")


@pytest.fixture
def watched(cleared: ClearedTrajectory, talk: tuple[Connection, Connection], tmp_path: Path) -> tuple[MonitorLink, Signs, At]:
    signs, clock = Signs(6, CONTEXT), At()
    link = MonitorLink(signs, talk[0], clock)
    write(talk[1], True)
    link.begin([cleared], 500.0, 0.01, tmp_path)
    return link, signs, clock


def test_the_guard_stops_where_the_monitor_process_is_silent(watched: tuple[MonitorLink, Signs, At]) -> None:
    link, signs, clock = watched
    assert link.reason() is None
    assert not link.sees
    signs.looked(5.0)
    assert link.sees
    clock.now = 5.0119
    assert link.reason() is None
    clock.now = 5.0121
    assert link.reason() == "the monitor process was silent for 12 ms, 12 ms are allowed"
    clock.now = float("nan")
    assert "was silent" in str(link.reason())


def test_the_guard_stops_where_the_monitor_process_wants_it_to(watched: tuple[MonitorLink, Signs, At]) -> None:
    link, signs, _ = watched
    signs.trip("j1: following error")
    assert link.reason() == "the monitor process found: j1: following error"


def test_every_command_is_shown(
    watched: tuple[MonitorLink, Signs, At],
    driver: PerfectDriver,
    arm: Arm,
    cell: Cell,
    clearance: Clearance,
    cleared: ClearedTrajectory,
) -> None:
    link, signs, _ = watched
    shown: list[tuple[int, np.ndarray]] = []

    def sent(k: int, q: np.ndarray) -> None:
        link.sent(k, q)
        signs.looked(5.0)
        shown.append((signs.last().k, signs.last().q))

    guard = Guard(driver, arm, cell, clearance, link.reason, sent=sent)
    with guard:
        guard.hold(0.01, "before")
        link.leg = 3
        guard.run(cleared, "the motion")
        assert signs.last().leg == 3
        guard.hold(0.01, "after")
    ks = [k for k, _ in shown]
    assert ks == [HOLDS] * 5 + list(range(len(cleared))) + [HOLDS] * 5 + [ENDED]
    np.testing.assert_array_equal([q for _, q in shown[5:-6]], cleared.q)


def test_the_guard_waits_until_it_is_seen(
    watched: tuple[MonitorLink, Signs, At], driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance
) -> None:
    link, signs, _ = watched
    with (
        pytest.raises(SafetyStop, match="saw no reading"),
        seen(link, lambda sent: Guard(driver, arm, cell, clearance, sent=sent)),
    ):
        raise AssertionError("the guard was not seen")
    assert signs.last().k == ENDED
    assert link.refusal() == ""
    signs.looked(5.0)
    with seen(link, lambda sent: Guard(driver, arm, cell, clearance, sent=sent)) as guard:
        assert guard._q_cmd.shape == (6,)


def test_the_first_stop_of_the_monitor_process_is_the_guards(
    watched: tuple[MonitorLink, Signs, At],
    driver: PerfectDriver,
    arm: Arm,
    cell: Cell,
    clearance: Clearance,
    cleared: ClearedTrajectory,
) -> None:
    link, signs, _ = watched

    def sent(k: int, q: np.ndarray) -> None:
        link.sent(k, q)
        if k == 400:
            signs.trip("its clearance is gone")

    guard = Guard(driver, arm, cell, clearance, link.reason, sent=sent)
    with guard, pytest.raises(MotionStopped, match="the monitor process found: its clearance is gone") as stopped:
        guard.run(cleared, "the motion")
    assert stopped.value.where.endswith("sample 400")
    assert stopped.value.standstill.at_rest
    assert isinstance(guard.monitor, Monitor)
