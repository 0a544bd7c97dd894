"""The control process and the monitor process beside it: what each does from its start until nothing holds the arm."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

from drivers.driver import Driver
from safety import realtime
from safety.audit import record
from safety.board import Board
from safety.execution import execute
from safety.monitor_link import MonitorLink
from safety.plan import load_plan
from safety.signs import Signs
from safety.stop_sources import StopSignals
from safety.watching import Task as WatchTask
from safety.watching import watch as watch_stages
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError, DeviceError

# s: the command process may be slow to draw; it counts as dead or hung when its heartbeat thread is silent for this long
SILENCE = 0.5
SHOW = 0.05
END_TIME = 1.0  # s within which the threads of a driver that holds nothing end


@dataclass(frozen=True)
class ControlTask:
    """The task of the control process, which loads arm, cell and plan from their files itself."""

    plan: Path
    cell: Path
    arm: Path
    driver_factory: Callable[[Cell, Arm], Driver]
    folder: Path
    audit: Path
    stages: tuple[float, ...] | None
    operator: str
    link: tuple[Signs, Connection] | None
    alone: str


def serve(task: ControlTask, board: Board, answer: Connection) -> None:
    """The control process."""
    os.setsid()
    link = None if task.link is None else MonitorLink(*task.link)
    with StopSignals() as signals:
        try:
            plan, cell, arm = load_plan(task.plan), load_cell(task.cell), load_arm(task.arm)
            realtime.prepare()

            def stop_requested() -> str | None:
                reason = signals.reason() or board.stop_requested()
                if reason is not None:
                    return reason
                if orphaned():
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
            _reply(answer, ("error", portable(error)))
        remain(board, task.audit)


def _reply(answer: Connection, what: tuple[str, Any]) -> None:
    """Send `what` to the command process, if it is alive; as bytes, so that only the guard calls anything named `send`."""
    with suppress(OSError):
        answer.send_bytes(ForkingPickler.dumps(what))


def orphaned() -> bool:
    """Whether the command process, which started this one, has died."""
    parent = multiprocessing.parent_process()
    return parent is not None and os.getppid() != parent.pid


def look(task: WatchTask, signs: Signs, talk: Connection, board: Board) -> None:
    """The monitor process, which then remains for as long as its driver holds the arm."""
    with suppress(CalibError):  # a driver that refuses to let go still holds the arm
        watch_stages(task, signs, talk)
    talk.close()
    remain(board, task.audit)


def remain(board: Board, audit: Path) -> None:
    """Wait until nothing holds the arm, or until somebody supports it: Ctrl-C in the command process, or SIGINT to this one."""
    # a driver that keeps holding does so in a thread of its own; the drives let go when it ends
    others = [t for t in threading.enumerate() if t is not threading.current_thread() and not t.daemon]
    with StopSignals():  # signals from before the arm was held stopped it; they do not let it go
        for thread in others:
            thread.join(END_TIME)
        alone = False
        with StopSignals() as signals:
            while any(t.is_alive() for t in others):
                board.hold()
                if board.may_let_go or signals.interrupted:
                    os._exit(0)
                if orphaned() and not alone:
                    alone = True
                    _tell(audit)
                time.sleep(SHOW)


def _tell(audit: Path) -> None:
    """Report that this process holds the arm, and its PID, because the command process, which would report it, is gone."""
    pid = os.getpid()
    sentence = f"the command process died; PID {pid} holds the arm: support it, then kill -INT {pid} to let it go"
    with suppress(CalibError):
        record(audit, "arm held", pid=pid, reason=sentence)
    with suppress(OSError):
        sys.stderr.write(f"calib: {sentence}\n")
        sys.stderr.flush()


def portable(error: BaseException) -> BaseException:
    """An error in a form that can cross a process boundary: without its cause, and as DeviceError if its own type cannot."""
    error.__cause__ = error.__context__ = error.__traceback__ = None
    if isinstance(error, Exception) and type(error).__module__.split(".")[0] in ("sim", "safety"):
        return error
    ours = isinstance(error, CalibError)
    out = DeviceError(str(error) if ours else f"the control process failed: {type(error).__name__}: {error}")
    for note in error.__dict__.get("__notes__", ()):
        out.add_note(note)
    return out
