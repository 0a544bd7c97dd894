"""Tasks in parallel, in processes of one thread each, or one after the other in this process."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

Task = TypeVar("Task")
Answer = TypeVar("Answer")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class Workers:
    """`run` returns the answers in the order of the tasks and reports the share done after each."""

    def __init__(self, pool: ProcessPoolExecutor | None) -> None:
        self._pool = pool

    def run(self, work: Callable[[Task], Answer], tasks: Sequence[Task], done: Callable[[float], None]) -> list[Answer]:
        """[work(task) ...]; an error in any of them is raised here."""
        answers = []
        if self._pool is None:
            for k, task in enumerate(tasks):
                answers.append(work(task))
                done((k + 1) / len(tasks))
            return answers
        with _without_script():
            waiting = [self._pool.submit(work, task) for task in tasks]
        for k, future in enumerate(as_completed(waiting)):
            future.result()
            done((k + 1) / len(tasks))
        return [future.result() for future in waiting]


@contextmanager
def _without_script() -> Iterator[None]:
    """Keep worker processes from importing the user's script.

    A script that calls `plan` outside `if __name__ == "__main__"` would otherwise start more of them.
    """
    script: dict[str, object] = vars(sys.modules["__main__"])
    hidden: dict[str, object] = {name: script.pop(name) for name in ("__file__", "__spec__") if name in script}
    script["__spec__"] = None
    try:
        yield
    finally:
        del script["__spec__"]
        script.update(hidden)


@contextmanager
def workers(count: int) -> Iterator[Workers]:
    """Pool of `count` processes while the context lasts; for a count of one, this process."""
    if count <= 1:
        yield Workers(None)
        return
    before = {k: os.environ.get(k) for k in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
            yield Workers(pool)
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value
