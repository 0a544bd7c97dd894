"""A control process that does not end, hangs or dies while answering is reported, and never waited for indefinitely."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import threading

import pytest

from safety import control
from safety.board import Board
from safety.run_progress import RunProgress
from safety.signs import Signs
from safety.stop_sources import StopSignals
from sim.errors import DeviceError


class Hung:
    """A process that ends only when it is killed."""

    name = "calib control"

    def __init__(self) -> None:
        self.exitcode: int | None = None
        self.joined: list[float] = []

    def join(self, timeout: float) -> None:
        self.joined.append(timeout)

    def kill(self) -> None:
        self.exitcode = -signal.SIGKILL


def test_a_process_that_does_not_end_is_reported_and_ended_by_ctrl_c_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "LEAVE_TIME", 0.1)
    board, hung = Board(6, multiprocessing.get_context("spawn")), Hung()
    said: list[str] = []

    def held(sentence: str) -> None:
        said.append(sentence)
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()

    with StopSignals():  # signals that arrive before the wait begins end nothing
        control._let_go([hung], board, "completed", held)
    wanted = f"support it, then press Ctrl-C or kill -INT {os.getpid()}"
    assert said == [f"completed; calib control did not end within 0.1 s and may hold the arm: {wanted}"]
    assert (hung.exitcode, hung.joined, board.may_let_go) == (-signal.SIGKILL, [control.LET_GO_TIME], True)


def test_a_control_process_that_hangs_after_a_stop_was_requested_is_not_waited_for_without_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(control, "STOP_TIME", 0.1)
    context = multiprocessing.get_context("spawn")
    board, (answer, held_open) = Board(6, context), context.Pipe(duplex=False)
    with pytest.raises(DeviceError, match=r"Ctrl-C, and the control process did not answer within 0\.1 s"):
        control._watched(Hung(), answer, board, lambda: "Ctrl-C", lambda progress: None, Signs(6, context))
    assert board.stop_requested() == "Ctrl-C"
    held_open.close()


def test_half_an_answer_of_a_control_process_that_was_killed_is_none() -> None:
    context = multiprocessing.get_context("spawn")
    answer, theirs = context.Pipe(duplex=False)
    os.write(theirs.fileno(), b"\0\0\1\0half")
    theirs.close()
    with pytest.raises(DeviceError, match="no answer"):
        control._watched(Hung(), answer, Board(6, context), lambda: None, lambda progress: None, Signs(6, context))


@pytest.mark.parametrize(
    ("refusal", "message"),
    [
        ("", r"took over and commanded the arm to stop; the guard was silent; look at the arm"),
        (
            "connection refused",
            r"the device refused its stop \(connection refused\): use the emergency stop; the guard was silent",
        ),
        (None, r"no stop of the arm is confirmed: use the emergency stop; the guard was silent"),
    ],
)
def test_what_is_reported_of_the_stop_is_what_the_monitor_process_achieved(
    monkeypatch: pytest.MonkeyPatch, refusal: str | None, message: str
) -> None:
    monkeypatch.setattr(control, "HALT_TIME", 0.1)
    context = multiprocessing.get_context("spawn")
    signs, (answer, theirs) = Signs(6, context), context.Pipe(duplex=False)
    signs.trip("the guard was silent")
    if refusal is not None:
        signs.halted(refusal)
    theirs.close()
    with pytest.raises(DeviceError, match=message):
        control._watched(Hung(), answer, Board(6, context), lambda: None, lambda progress: None, signs)


def test_a_view_that_cannot_be_written_any_more_is_a_stop_with_that_reason() -> None:
    context = multiprocessing.get_context("spawn")
    board, (answer, theirs) = Board(6, context), context.Pipe(duplex=False)

    def watch(progress: RunProgress) -> None:
        threading.Timer(0.3, theirs.send, [("done", "stopped")]).start()
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    assert control._watched(Hung(), answer, board, lambda: None, watch, Signs(6, context)) == ("done", "stopped")
    assert board.stop_requested() == "the run can no longer be shown (Broken pipe)"
    theirs.close()
