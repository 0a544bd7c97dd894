"""What one process writes, the other reads; the first reason for a stop is kept."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from safety import board as board_file
from safety.board import TEXT, Board
from safety.run_progress import Cycle, RunProgress
from sim.joint_state import JointState


@pytest.fixture
def board() -> Board:
    return Board(2, multiprocessing.get_context("spawn"))


def cycle(k: int) -> Cycle:
    values = np.arange(2.0) + k
    return Cycle(k, 100, JointState(7.0, 7.0, *(values + 10 * i for i in range(4)), np.full(2, np.nan)), values + 50)


def test_a_new_board_says_nothing(board: Board) -> None:
    assert board.stop_requested() is None
    assert not board.held
    assert not board.may_let_go
    assert board.progress() == RunProgress("", 0.0, None, speed=0.0)


def test_the_first_reason_stays(board: Board) -> None:
    board.request_stop("Ctrl-C")
    board.request_stop("the terminal was closed")
    assert board.stop_requested() == "Ctrl-C"
    assert not board.may_let_go


def test_a_long_reason_is_cut_and_still_one(board: Board) -> None:
    board.request_stop("\u00e9" * TEXT)
    assert board.stop_requested()


def test_to_let_go_is_a_wish_of_its_own(board: Board) -> None:
    board.hold()
    assert board.held
    assert board.stop_requested() is None
    board.let_go()
    assert board.may_let_go


def test_a_heartbeat_that_ends_is_noticed(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    assert board.alive_within(60.0)
    now = board_file.time.monotonic()
    monkeypatch.setattr(board_file.time, "monotonic", lambda: now + 61.0)
    assert not board.alive_within(60.0)
    board.beat()
    assert board.alive_within(60.0)


def test_a_motion_is_named_at_its_beginning_and_its_numbers_go_on(board: Board) -> None:
    board.show(RunProgress("friction", 0.1, cycle(0), 1, 2, 0.5, 3.0, 4.0, 5, 6))
    board.show(RunProgress("not written again", 0.2, cycle(3), 1, 2, 0.5, 3.0, 3.5, 8, 7))
    seen = board.progress()
    assert (seen.what, seen.share, seen.stage, seen.stages, seen.speed) == ("friction", 0.2, 1, 2, 0.5)
    assert (seen.duration, seen.left, seen.frames, seen.lost) == (3.0, 3.5, 8, 7)
    assert seen.cycle is not None
    assert (seen.cycle.k, seen.cycle.count, seen.cycle.state.t_device) == (3, 100, 7.0)
    for name, first in (("q", 3.0), ("dq", 13.0), ("tau", 23.0), ("current", 33.0)):
        np.testing.assert_array_equal(getattr(seen.cycle.state, name), [first, first + 1])
    assert np.isnan(seen.cycle.state.temperature).all()
    np.testing.assert_array_equal(seen.cycle.q_cmd, [53.0, 54.0])


def test_what_is_no_motion_is_named_too(board: Board) -> None:
    board.show(RunProgress("clearing the plan", 0.0, None))
    assert board.progress().what == "clearing the plan"
    assert board.progress().cycle is None
