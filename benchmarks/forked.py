"""Jobs in forked children of one warm process: modules and compiled code load once; a crash or hang ends one child only."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import pkgutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from types import ModuleType
from typing import IO, Any

WORKERS = os.cpu_count() or 1


@dataclass(frozen=True)
class Done:
    """Result of a job. fault: why there is none, or empty; leaked: what the process printed."""

    key: str
    value: Any
    fault: str
    leaked: str


def warm(*packages: ModuleType) -> None:
    """Import every module of the packages, so that no child has to. A module that cannot be imported is skipped."""
    for package in packages:
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                with contextlib.suppress(ImportError):
                    importlib.import_module(module.name)


def forked(
    jobs: Iterable[tuple[str, Callable[[], Any]]], longest: float, until: float = float("inf"), workers: int = WORKERS
) -> Iterator[Done]:  # fmt: skip
    """Run each job (key, call) in its own child, `workers` at a time; yield results as they finish.

    No job starts after `until`, s of time.monotonic(). A child running longer than `longest` s is killed with its whole process
    group. The caller must have no other thread.
    """
    gc.freeze()  # a garbage collection in a child would copy every page with an object of this process
    waiting, running = iter(jobs), {}
    while True:
        while len(running) < workers and time.monotonic() < until and (job := next(waiting, None)):
            child = _Child(*job, longest)
            running[child.answer] = child
        if not running:
            return
        soonest = min(child.end for child in running.values())
        for answer in wait(list(running), max(soonest - time.monotonic(), 0.0)):
            yield running.pop(answer).done()  # type: ignore[arg-type]
        for answer in [a for a, child in running.items() if time.monotonic() > child.end]:
            yield running.pop(answer).killed()


class _Child:
    def __init__(self, key: str, call: Callable[[], Any], longest: float) -> None:
        self.key, self.end, self._longest = key, time.monotonic() + longest, longest
        self.answer, theirs = get_context("fork").Pipe(duplex=False)
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115  (open until the child has ended)
        self._process: ForkProcess = get_context("fork").Process(target=_run, args=(call, theirs, self._printed))
        self._process.start()
        theirs.close()

    def done(self) -> Done:
        value = None
        with contextlib.suppress(EOFError):
            value = (self.answer.recv(),)
        self._process.join()
        code, printed = self._process.exitcode, self._text()
        if value is None or code:
            return Done(self.key, None, f"ended with {code}: {printed[-300:]}", "")
        return Done(self.key, value[0], "", printed)

    def killed(self) -> Done:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid or 0, signal.SIGKILL) if self._process.pid else None
        self._process.join()
        return Done(self.key, None, f"not within {self._longest:g} s", self._text())

    def _text(self) -> str:
        self._printed.seek(0)
        text = self._printed.read().decode("utf-8", "replace").strip()
        self._printed.close()
        self.answer.close()
        return text


def _run(call: Callable[[], Any], answer: Connection, printed: IO[bytes]) -> None:
    os.setpgid(0, 0)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    for stream in (1, 2):
        os.dup2(printed.fileno(), stream)
    sys.stdout, sys.stderr = (open(stream, "w", buffering=1, closefd=False) for stream in (1, 2))  # noqa: SIM115
    answer.send(call())
