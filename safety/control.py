"""The control process: `execute` in a process of its own, watched and fed by the command process, and safe without it.

It has a session of its own, so Ctrl-C and a closed terminal reach only the command process, which asks for the stop. If the command
process dies or hangs, its heartbeat ends and the arm is stopped and the log closed all the same. It clears every motion again
before it sends any: nothing that another process proved is taken on trust.
"""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.driver import Driver
from drivers.mock import MockOptions
from safety import realtime
from safety.board import Board
from safety.execution import NEVER, RunProgress, RunResult, execute
from safety.plan import Plan, load_plan
from safety.stop_sources import REASONS, StopSignals, first_reason
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import DeviceError
from sim.strict import validated

# The command process may be slow to draw; it is dead or hung when its heartbeat thread is silent for so long
SILENCE = 0.5
BEAT = 0.02
SHOW = 0.05
END_TIME = 1.0  # s in which the threads of a driver end that holds nothing


@dataclass(frozen=True)
class _Task:
    """The task of the control process; it loads arm, cell and plan from their files itself."""

    plan: Path
    cell: Path
    arm: Path
    driver_factory: Callable[[Cell, Arm], Driver]
    folder: Path
    audit: Path
    stages: tuple[float, ...] | None
    operator: str
    parent: int


def is_simulated(cell: Cell) -> bool:
    """Whether time in this cell is simulated, so that nothing has to keep up with it."""
    return cell.table.driver == "mock" and not validated(MockOptions, cell.table.options, cell.path).realtime


def drive(
    plan: Plan,
    cell: Cell,
    arm: Arm,
    driver_factory: Callable[[Cell, Arm], Driver],
    folder: Path,
    *,
    audit: Path,
    stages: Sequence[float] | None = None,
    operator: str = "",
    stop_requested: Callable[[], str | None] = NEVER,
    watch: Callable[[RunProgress], None] = lambda progress: None,
    held: Callable[[str], None] = lambda sentence: None,
) -> RunResult:
    """`execute` where it belongs: here for a simulated cell, in a control process of its own for every other.

    Where the driver goes on holding the arm after a failure, because torque off would drop it, `held` gets the reason, and this returns
    only when somebody who supports the arm presses Ctrl-C. driver_factory must be a function of a module. Raises what `execute`
    raises; DeviceError where the control process was lost.
    """
    if is_simulated(cell):
        return execute(
            plan,
            cell,
            arm,
            driver_factory,
            folder,
            audit=audit,
            stages=stages,
            operator=operator,
            stop_requested=stop_requested,
            watch=watch,
        )
    context = multiprocessing.get_context("spawn")
    board = Board(arm.n, context)
    answer: Any = context.Queue()
    wanted = None if stages is None else tuple(stages)
    task = _Task(
        plan.folder.resolve(), cell.path.resolve(), arm.model_path.resolve().parent, driver_factory, folder.resolve(),
        audit.resolve(), wanted, operator, os.getpid(),
    )  # fmt: skip
    process = context.Process(target=_serve, args=(task, board, answer), name="calib control")
    over = threading.Event()
    with StopSignals() as signals:
        heart = threading.Thread(target=_beat, args=(board, over), daemon=True)
        board.beat()
        heart.start()
        process.start()
        try:
            kind, value = _watched(process, answer, board, first_reason(signals.reason, stop_requested), watch)
        except BaseException:
            board.request_stop("the command process failed")
            _let_go(process, board, "the command process failed", held)
            raise
        finally:
            over.set()
            heart.join()
    _let_go(process, board, str(value), held)
    if kind == "error":
        raise value
    return value  # type: ignore[no-any-return]


def _let_go(process: Any, board: Board, sentence: str, held: Callable[[str], None]) -> None:
    """Wait for the control process; where it holds the arm, until Ctrl-C says that somebody supports it. Nothing else lets go."""
    with StopSignals():
        while process.exitcode is None and not board.held:
            process.join(SHOW)
    if process.exitcode is not None:
        return
    held(f"{sentence}; the arm is HELD: support it, then press Ctrl-C to let it go")
    while process.exitcode is None:
        with StopSignals() as signals:
            while process.exitcode is None and signals.reason() is None:
                process.join(SHOW)
        if signals.reason() == REASONS[signal.SIGINT]:
            board.let_go()


def _beat(board: Board, over: threading.Event) -> None:
    while not over.wait(BEAT):
        board.beat()


def _watched(
    process: Any, answer: Any, board: Board, stop_requested: Callable[[], str | None], watch: Callable[[RunProgress], None]
) -> tuple[str, Any]:
    """Show what the control process does until it answers; pass a wish to stop on to it."""
    while True:
        try:
            return answer.get(timeout=SHOW)  # type: ignore[no-any-return]
        except queue.Empty:
            pass
        if not process.is_alive():
            try:
                return answer.get(timeout=1.0)  # type: ignore[no-any-return]
            except queue.Empty:
                raise DeviceError(
                    f"the control process ended with exit code {process.exitcode} and no answer; the device's own watchdog has stopped "
                    "the arm: look at it before anything else, then recover the log with `calib import`"
                ) from None
        reason = stop_requested()
        if reason is None:
            watch(board.progress())
        else:  # a terminal that was closed can show nothing any more
            board.request_stop(reason)


def _serve(task: _Task, board: Board, answer: Any) -> None:
    """The control process."""
    os.setsid()
    try:
        plan, cell, arm = load_plan(task.plan), load_cell(task.cell), load_arm(task.arm)
        realtime.prepare()

        def stop_requested() -> str | None:
            reason = board.stop_requested()
            if reason is not None:
                return reason
            if os.getppid() != task.parent:
                return "the command process died"
            if not board.alive_within(SILENCE):
                return f"the command process was silent for {SILENCE:g} s"
            return None

        result = execute(
            plan, cell, arm, task.driver_factory, task.folder, audit=task.audit, stages=task.stages, operator=task.operator,
            stop_requested=stop_requested, watch=board.show,
        )  # fmt: skip
        answer.put(("done", result))
    except BaseException as error:
        answer.put(("error", _portable(error)))
    # a driver that goes on holding does so in a thread of its own; the drives let go when it ends
    others = [t for t in threading.enumerate() if t is not threading.current_thread() and not t.daemon]
    for thread in others:
        thread.join(END_TIME)
    while any(t.is_alive() for t in others):
        board.hold()
        if board.may_let_go:
            os._exit(0)
        time.sleep(SHOW)


def _portable(error: BaseException) -> BaseException:
    """An error as it can cross a process boundary: without its cause, and as DeviceError where its own kind cannot."""
    error.__cause__ = error.__context__ = error.__traceback__ = None
    if isinstance(error, Exception) and type(error).__module__.split(".")[0] in ("sim", "safety"):
        return error
    return DeviceError(f"the control process failed: {type(error).__name__}: {error}")
