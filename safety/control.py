"""The command process: `execute` in a control process of its own, watched from here, and safe without this process.

The control process has its own session, so Ctrl-C and a closed terminal reach only the command process, which requests the
stop. If the command process dies or hangs, its heartbeat ends, and the arm is stopped and the log closed all the same. The
control process clears every motion again before it sends any: it trusts no verification of another process.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from drivers.driver import Driver
from drivers.mock import MockOptions
from safety import realtime
from safety.audit import record
from safety.board import Board
from safety.control_process import END_TIME, SHOW, ControlTask, look, serve
from safety.execution import NEVER, SIMULATED, RunResult, execute
from safety.plan import Plan
from safety.run_progress import RunProgress
from safety.signs import Signs
from safety.stop_sources import StopSignals, first_reason
from safety.watching import Task as WatchTask
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import CalibError, DeviceError
from sim.strict import validated

BEAT = 0.02
LET_GO_TIME = 5.0  # s for a process that holds the arm to let go after Ctrl-C; then it is killed
STOP_TIME = 120.0  # s to stop and to close the log of a long run, after which the control process counts as hung
HALT_TIME = 5.0  # s for the monitor process to command its own stop after it ended the control process
LEAVE_TIME = 30.0  # s for both processes to end after the run: more than the monitor process waits for the control process


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
    """`execute` in the right process: this one for a simulated cell, a control process of its own for every other.

    If the driver keeps holding the arm after a failure, because it would drop without torque, `held` gets the reason. This then
    returns only when somebody who supports the arm presses Ctrl-C. driver_factory must be a function of a module. Raises what
    `execute` raises; DeviceError if the control process was lost.
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
    task = ControlTask(*files, folder.resolve(), audit.resolve(), wanted, operator, None if alone else (signs, ends[0]), alone)
    process = context.Process(target=serve, args=(task, board, answers), name="calib control")
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
            processes.append(context.Process(target=look, args=(seen, signs, ends[1], board), name="calib monitor"))
            processes[1].start()
        for end in (*ends, answers):  # so that each of them closes when the process at its other end ends
            end.close()

        def shown(sentence: str) -> None:
            """Record it too, and tolerate a closed terminal: others must learn that the arm is held, and by which process."""
            with suppress(CalibError):
                record(audit, "arm held", pid=os.getpid(), reason=sentence)
            with suppress(OSError):
                held(sentence)

        try:
            with realtime.attentive():  # a heartbeat delayed by other programs would stop the arm
                kind, value = _watched(process, answer, board, first_reason(signals.reason, stop_requested), watch, signs)
        except BaseException:
            board.request_stop("the command process failed")
            _let_go(processes, board, "the command process failed", shown)
            raise
        finally:
            over.set()
            heart.join()
        _let_go(processes, board, str(value), shown)
    if kind == "error":
        raise value
    return value  # type: ignore[no-any-return]


def alone_because(driver_factory: Callable[[Cell, Arm], Driver], cell: Cell, arm: Arm) -> str:
    """Why no monitor process checks this device beside the control process; empty if one does."""
    if is_simulated(cell):
        return SIMULATED
    if not hasattr(os, "pidfd_open"):
        return "this system has no pidfd_open, so a hung control process could not be ended reliably"
    try:
        return driver_factory(cell, arm).beside()
    except Exception as error:  # the control process gets the same error and reports it
        return f"its driver cannot be made: {error}"


def _let_go(processes: list[Any], board: Board, sentence: str, shown: Callable[[str], None]) -> None:
    """Wait for the processes to end. If one holds the arm or hangs, only Ctrl-C by somebody who supports the arm ends it."""

    def alive() -> list[str]:
        return [p.name for p in processes if p.exitcode is None]

    end, ctrl_c = time.monotonic() + LEAVE_TIME, f"press Ctrl-C or kill -INT {os.getpid()}"
    with StopSignals():  # no signal that comes meanwhile ends this process before the others
        while alive() and not board.held and time.monotonic() < end:
            time.sleep(SHOW)
        if board.held and alive():
            shown(f"{sentence}; the arm is HELD: support it, then {ctrl_c} to let it go")
        elif alive():
            shown(
                f"{sentence}; {' and '.join(alive())} did not end within {LEAVE_TIME:g} s and may hold the arm: support it, then {ctrl_c}"
            )
        with StopSignals() as signals:
            while alive():
                time.sleep(SHOW)
                if not signals.interrupted:
                    continue
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
    """Show the progress of the control process until it answers; pass stop requests on to it."""
    since, unseen = np.inf, None
    while True:
        try:
            if answer.poll(SHOW):
                return answer.recv()  # type: ignore[no-any-return]
        except (EOFError, OSError):
            process.join(END_TIME)
            raise DeviceError(_after_the_loss(process.exitcode, signs)) from None
        reason = stop_requested() or unseen
        if reason is None:
            try:
                watch(board.progress())
            except OSError as error:
                unseen = f"the run can no longer be shown ({error.strerror})"
            continue
        board.request_stop(reason)  # a closed terminal can show nothing
        since = min(since, time.monotonic())
        if time.monotonic() - since > STOP_TIME:
            raise DeviceError(
                f"{reason}, and the control process did not answer within {STOP_TIME:g} s: it hangs; look at the arm before anything else, then "
                "recover the log with `calib import`"
            )


def _after_the_loss(exitcode: int | None, signs: Signs) -> str:
    """What is known of the arm when the control process has ended without an answer, and what to do."""
    recover = "look at the arm before anything else, then recover the log with `calib import`"
    if signs.tripped is None:
        return (
            f"the control process ended with exit code {exitcode} and no answer; the device's own watchdog should stop the arm, which "
            f"nothing has confirmed: {recover}"
        )
    end = time.monotonic() + HALT_TIME
    while signs.halt is None and time.monotonic() < end:
        time.sleep(SHOW)
    if signs.halt is None:
        done = "the control process ended after a finding of the monitor process, and no stop of the arm is confirmed: use the emergency stop"
    elif signs.halt:
        done = f"the monitor process took over, and the device refused its stop ({signs.halt}): use the emergency stop"
    else:
        done = "the monitor process took over and commanded the arm to stop"
    return f"{done}; {signs.tripped}; {recover}"
