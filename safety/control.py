"""The control process: `execute` in a process of its own, watched and fed by the command process, and safe without it.

It has a session of its own, so Ctrl-C and a closed terminal reach only the command process, which asks for the stop. If the command
process dies or hangs, its heartbeat ends and the arm is stopped and the log closed all the same. It clears every motion again
before it sends any: nothing that another process proved is taken on trust.
"""

from __future__ import annotations

import ctypes
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

import numpy as np

from drivers.driver import Driver
from drivers.mock import MockOptions
from safety import realtime
from safety.execution import NEVER, Progress, Recorded, execute
from safety.guard import Cycle
from safety.plan import Plan, load_plan
from safety.stop_sources import REASONS, StopSignals, first_reason
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import DeviceError
from sim.joint_state import JointState
from sim.strict import validated

# The command process may be slow to draw; it is dead or hung when its heartbeat thread is silent for so long
SILENCE = 0.5
BEAT = 0.02
SHOW = 0.05
END_TIME = 1.0  # s in which the threads of a driver end that holds nothing
LET_GO = 2.0
TEXT = 200
BEAT_AT, STOP_AT, HELD_AT, SHARE_AT, K_AT, COUNT_AT, T_AT, RUN_AT, ARRAYS = 0, 1, 2, 3, 4, 5, 6, 7, 14
SHOWN = ("q", "dq", "tau", "current", "temperature")


@dataclass(frozen=True)
class _Task:
    """What the control process is told; it loads arm, cell and plan from their files itself."""

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
    stop_asked: Callable[[], str | None] = NEVER,
    watch: Callable[[Progress], None] = lambda progress: None,
    held: Callable[[str], None] = lambda sentence: None,
) -> Recorded:
    """`execute` where it belongs: here for a simulated cell, in a control process of its own for every other.

    Where the driver goes on holding the arm after a failure, because torque off would drop it, `held` is told why, and this returns
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
            stop_asked=stop_asked,
            watch=watch,
        )
    context = multiprocessing.get_context("spawn")
    numbers, text = context.RawArray(ctypes.c_double, ARRAYS + (len(SHOWN) + 1) * arm.n), context.RawArray(ctypes.c_char, TEXT)
    answer: Any = context.Queue()
    wanted = None if stages is None else tuple(stages)
    task = _Task(
        plan.folder.resolve(), cell.path.resolve(), arm.model_path.resolve().parent, driver_factory, folder.resolve(),
        audit.resolve(), wanted, operator, os.getpid(),
    )  # fmt: skip
    numbers[BEAT_AT] = time.monotonic()
    process = context.Process(target=_serve, args=(task, numbers, text, answer), name="calib control")
    over = threading.Event()
    with StopSignals() as signals:
        heart = threading.Thread(target=_beat, args=(numbers, over), daemon=True)
        heart.start()
        process.start()
        try:
            kind, value = _watched(process, answer, numbers, text, first_reason(signals.reason, stop_asked), watch, arm.n)
        except BaseException:
            numbers[STOP_AT] = 1.0
            _let_go(process, numbers, "the command process failed", held)
            raise
        finally:
            over.set()
            heart.join()
    _let_go(process, numbers, str(value), held)
    if kind == "error":
        raise value
    return value  # type: ignore[no-any-return]


def _let_go(process: Any, numbers: Any, sentence: str, held: Callable[[str], None]) -> None:
    """Wait for the control process; where it holds the arm, until Ctrl-C says that somebody supports it. Nothing else lets go."""
    with StopSignals():
        while process.exitcode is None and not numbers[HELD_AT]:
            process.join(SHOW)
    if process.exitcode is not None:
        return
    held(f"{sentence}; the arm is HELD: support it, then press Ctrl-C to let it go")
    while process.exitcode is None:
        with StopSignals() as signals:
            while process.exitcode is None and signals.reason() is None:
                process.join(SHOW)
        if signals.reason() == REASONS[signal.SIGINT]:
            numbers[STOP_AT] = LET_GO


def _beat(numbers: Any, over: threading.Event) -> None:
    while not over.wait(BEAT):
        numbers[BEAT_AT] = time.monotonic()


def _watched(
    process: Any,
    answer: Any,
    numbers: Any,
    text: Any,
    asked: Callable[[], str | None],
    watch: Callable[[Progress], None],
    n: int,
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
        reason = asked()
        if reason is not None:
            text.raw = reason.encode()[: TEXT - 1].ljust(TEXT, b"\0")
            numbers[STOP_AT] = 1.0
        if not numbers[STOP_AT]:
            q, dq, tau, current, temperature, q_cmd = np.array(numbers[ARRAYS:]).reshape(-1, n)
            state = JointState(numbers[T_AT], numbers[T_AT], q, dq, tau, current, temperature)
            cycle = Cycle(int(numbers[K_AT]), int(numbers[COUNT_AT]), state, q_cmd) if numbers[COUNT_AT] else None
            stage, stages, speed, duration, left, frames, lost = numbers[RUN_AT:ARRAYS]
            run = (int(stage), int(stages), speed, duration, left, int(frames), int(lost))
            watch(Progress(text.value.decode(errors="replace"), numbers[SHARE_AT], cycle, *run))


def _serve(task: _Task, numbers: Any, text: Any, answer: Any) -> None:
    """The control process."""
    os.setsid()
    try:
        plan, cell, arm = load_plan(task.plan), load_cell(task.cell), load_arm(task.arm)
        realtime.prepare()

        def asked() -> str | None:
            if numbers[STOP_AT]:
                return text.value.decode(errors="replace") or "the command process asked for it"
            if os.getppid() != task.parent:
                return "the command process died"
            if not time.monotonic() - numbers[BEAT_AT] <= SILENCE:
                return f"the command process was silent for {SILENCE:g} s"
            return None

        def watch(progress: Progress) -> None:
            if numbers[STOP_AT]:
                return
            if progress.cycle is None or progress.cycle.k == 0:
                text.raw = progress.what.encode()[: TEXT - 1].ljust(TEXT, b"\0")
            numbers[SHARE_AT] = progress.share
            if progress.cycle is not None:
                state, p = progress.cycle.state, progress
                numbers[K_AT], numbers[COUNT_AT], numbers[T_AT] = progress.cycle.k, progress.cycle.count, state.t_device
                numbers[RUN_AT:ARRAYS] = [p.stage, p.stages, p.speed, p.duration, p.left, p.frames, p.lost]
                numbers[ARRAYS:] = np.concatenate(
                    [state.q, state.dq, state.tau, state.current, state.temperature, progress.cycle.q_cmd]
                ).tolist()

        result = execute(
            plan, cell, arm, task.driver_factory, task.folder, audit=task.audit, stages=task.stages, operator=task.operator,
            stop_asked=asked, watch=watch,
        )  # fmt: skip
        answer.put(("done", result))
    except BaseException as error:
        answer.put(("error", _portable(error)))
    # a driver that goes on holding does so in a thread of its own; the drives let go when it ends
    others = [t for t in threading.enumerate() if t is not threading.current_thread() and not t.daemon]
    for thread in others:
        thread.join(END_TIME)
    while any(t.is_alive() for t in others):
        numbers[HELD_AT] = 1.0
        if numbers[STOP_AT] == LET_GO:
            os._exit(0)
        time.sleep(SHOW)


def _portable(error: BaseException) -> BaseException:
    """An error as it can cross a process boundary: without its cause, and as DeviceError where its own kind cannot."""
    error.__cause__ = error.__context__ = error.__traceback__ = None
    if isinstance(error, Exception) and type(error).__module__.split(".")[0] in ("sim", "safety"):
        return error
    return DeviceError(f"the control process failed: {type(error).__name__}: {error}")
