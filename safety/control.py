"""The control process: `execute` in a process of its own, watched and fed by the command process, and safe without it.

It has a session of its own, so Ctrl-C and a closed terminal reach only the command process, which asks for the stop. If the command
process dies or hangs, its heartbeat ends and the arm is stopped and the log closed all the same. It clears every motion again
before it sends any: nothing that another process proved is taken on trust.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np

from drivers.driver import Driver
from drivers.mock import MockOptions
from safety import realtime
from safety.audit import record
from safety.board import Board
from safety.execution import NEVER, SIMULATED, RunProgress, RunResult, execute
from safety.monitor_link import MonitorLink
from safety.plan import Plan, load_plan
from safety.signs import Signs
from safety.stop_sources import REASONS, StopSignals, first_reason
from safety.watching import Task as WatchTask
from safety.watching import watch as watch_stages
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError, DeviceError
from sim.strict import validated

# The command process may be slow to draw; it is dead or hung when its heartbeat thread is silent for so long
SILENCE = 0.5
BEAT = 0.02
SHOW = 0.05
END_TIME = 1.0  # s in which the threads of a driver end that holds nothing
LET_GO_TIME = 5.0  # s for a process that holds the arm to let go after Ctrl-C; what hangs is killed then
STOP_TIME = 120.0  # s to stop and to close the log of a long run, after which the control process counts as hung
LEAVE_TIME = 30.0  # s for both processes to end after the run: more than the monitor process waits for the control process


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
    link: tuple[Signs, Connection] | None
    alone: str


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
    answer, answers = context.Pipe(duplex=False)
    wanted = None if stages is None else tuple(stages)
    alone = alone_because(driver_factory, cell, arm)
    signs, ends = Signs(arm.n, context), context.Pipe()
    files = plan.folder.resolve(), cell.path.resolve(), arm.model_path.resolve().parent, driver_factory
    task = _Task(
        *files, folder.resolve(), audit.resolve(), wanted, operator, os.getpid(), None if alone else (signs, ends[0]), alone
    )
    process = context.Process(target=_serve, args=(task, board, answers), name="calib control")
    if alone:
        record(audit, "no monitor process", reason=alone)
    over = threading.Event()
    with StopSignals() as signals:
        heart = threading.Thread(target=_beat, args=(board, over), daemon=True)
        board.beat()
        heart.start()
        process.start()
        processes = [process]
        if not alone:
            assert process.pid is not None
            seen = WatchTask(*files, audit.resolve(), process.pid)
            processes.append(context.Process(target=_look, args=(seen, signs, ends[1], board), name="calib monitor"))
            processes[1].start()
        for end in (*ends, answers):  # so that each of them ends with the process that has the other end
            end.close()
        try:
            kind, value = _watched(process, answer, board, first_reason(signals.reason, stop_requested), watch, signs)
        except BaseException:
            board.request_stop("the command process failed")
            _let_go(processes, board, "the command process failed", held)
            raise
        finally:
            over.set()
            heart.join()
    _let_go(processes, board, str(value), held)
    if kind == "error":
        raise value
    return value  # type: ignore[no-any-return]


def alone_because(driver_factory: Callable[[Cell, Arm], Driver], cell: Cell, arm: Arm) -> str:
    """Why no monitor process looks at this device beside the control process; empty where one does."""
    if is_simulated(cell):
        return SIMULATED
    if not hasattr(os, "pidfd_open"):
        return "this system has no pidfd_open, so nobody could end a hung control process for certain"
    try:
        return driver_factory(cell, arm).beside()
    except Exception as error:  # the control process meets it too, and reports it
        return f"its driver cannot be made: {error}"


def _let_go(processes: list[Any], board: Board, sentence: str, held: Callable[[str], None]) -> None:
    """Wait for the processes; where one holds the arm, or does not end, until Ctrl-C says that somebody supports it. Nothing else lets go."""

    def alive() -> list[str]:
        return [p.name for p in processes if p.exitcode is None]

    end = time.monotonic() + LEAVE_TIME
    with StopSignals():
        while alive() and not board.held and time.monotonic() < end:
            time.sleep(SHOW)
    if board.held and alive():
        held(f"{sentence}; the arm is HELD: support it, then press Ctrl-C to let it go")
    elif alive():
        held(
            f"{sentence}; {' and '.join(alive())} did not end within {LEAVE_TIME:g} s and may hold the arm: support it, then press Ctrl-C"
        )
    while alive():
        with StopSignals() as signals:
            while alive() and signals.reason() is None:
                time.sleep(SHOW)
        if signals.reason() == REASONS[signal.SIGINT]:
            board.let_go()
            for process in processes:
                process.join(LET_GO_TIME)
                if process.exitcode is None:
                    process.kill()


def _beat(board: Board, over: threading.Event) -> None:
    while not over.wait(BEAT):
        board.beat()


def _watched(
    process: Any, answer: Connection, board: Board, stop_requested: Callable[[], str | None], watch: Callable[[RunProgress], None],
    signs: Signs,
) -> tuple[str, Any]:  # fmt: skip
    """Show what the control process does until it answers; pass a wish to stop on to it."""
    since = np.inf
    while True:
        try:
            if answer.poll(SHOW):
                return answer.recv()  # type: ignore[no-any-return]
        except (EOFError, OSError):
            process.join(END_TIME)
            if signs.tripped is not None:
                raise DeviceError(
                    f"the monitor process ended the control process and stopped the arm: {signs.tripped}; look at the arm before "
                    "anything else, then recover the log with `calib import`"
                ) from None
            raise DeviceError(
                f"the control process ended with exit code {process.exitcode} and no answer; the device's own watchdog has stopped "
                "the arm: look at it before anything else, then recover the log with `calib import`"
            ) from None
        reason = stop_requested()
        if reason is None:
            watch(board.progress())
            continue
        board.request_stop(reason)  # a terminal that was closed can show nothing any more
        since = min(since, time.monotonic())
        if time.monotonic() - since > STOP_TIME:
            raise DeviceError(
                f"{reason}, and the control process did not answer within {STOP_TIME:g} s: it hangs; look at the arm before anything else, then "
                "recover the log with `calib import`"
            )


def _serve(task: _Task, board: Board, answer: Connection) -> None:
    """The control process."""
    os.setsid()
    link = None if task.link is None else MonitorLink(*task.link)
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
            stop_requested=stop_requested, watch=board.show, link=link, alone=task.alone,
        )  # fmt: skip
        _reply(answer, ("done", result))
    except BaseException as error:
        _reply(answer, ("error", _portable(error)))
    _remain(board)


def _reply(answer: Connection, what: tuple[str, Any]) -> None:
    """`what` to the command process; by bytes, so that nothing but the guard calls anything named `send`."""
    answer.send_bytes(ForkingPickler.dumps(what))


def _look(task: WatchTask, signs: Signs, talk: Connection, board: Board) -> None:
    """The monitor process, and beyond it for as long as its driver holds the arm."""
    with suppress(CalibError):  # what the driver refuses to let go of, it holds
        watch_stages(task, signs, talk)
    talk.close()
    _remain(board)


def _remain(board: Board) -> None:
    """Until nothing holds the arm any more, or somebody supports it."""
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
