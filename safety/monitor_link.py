"""The guard's side of the monitor process: passes on verified motions and every command, stops at its request or silence."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from safety.clear import ClearedTrajectory
from safety.guard import Guard
from safety.monitor import PERIODS
from safety.signs import Signs
from sim.errors import SafetyStop

ANSWER_TIME = 60.0  # s for the monitor process to load and check what a stage needs, on a busy computer
SEEN_TIME = 6.0  # s within which it must see the arm
PAUSE = 0.1


def tube_file(folder: Path, motions: Sequence[ClearedTrajectory]) -> Path:
    """Write the samples of these motions to one file for `VerifiedSamples`; returns its path."""
    file = folder / "tube.npy"
    out = np.lib.format.open_memmap(file, "w+", float, (sum(map(len, motions)), 5 * motions[0].q.shape[1] + 1))
    begin = 0
    for m in motions:
        out[begin : begin + len(m)] = np.hstack((m.q, m.tau_hat, m.doubt, m.sudden, m.load, m.room[:, None]))
        begin += len(m)
    out.flush()
    return file


def silence_of(rate: float, latency: float) -> float:
    """s that either process may be silent: as long as a reading may be late."""
    return max(PERIODS / rate, latency + 1.0 / rate)


def write(talk: Connection, what: object) -> None:
    """Send one message to the other process, as JSON."""
    talk.send_bytes(json.dumps(what).encode())


def read(talk: Connection) -> Any:
    """The next message; EOFError if the other process has ended."""
    return json.loads(talk.recv_bytes())


class Order(NamedTuple):
    """A stage that is about to begin: the file with its tube, number of samples of each motion, control rate Hz, latency s."""

    file: str
    counts: list[int]
    rate: float
    latency: float


class MonitorLink:
    """The guard's side of the monitor process."""

    def __init__(self, signs: Signs, talk: Connection, clock: Callable[[], float] = time.monotonic) -> None:
        self._signs, self._talk, self._clock = signs, talk, clock
        self._silence = np.inf
        self.leg = 0

    def begin(self, motions: Sequence[ClearedTrajectory], rate: float, latency: float, folder: Path) -> None:
        """Hand over a stage; SafetyStop if the monitor process refuses it or does not answer."""
        self._silence, self.leg = silence_of(rate, latency), 0
        self._signs.looked(-np.inf)
        file = tube_file(folder, motions)
        try:
            self._ask(Order(str(file), [len(m) for m in motions], rate, latency))
        finally:
            file.unlink(missing_ok=True)

    def end(self) -> dict[str, float]:
        """Statistics of the monitor process over the stage: number of cycles and their times, us."""
        answer = self._ask(None)
        return answer if isinstance(answer, dict) else {}

    def _ask(self, order: Order | None) -> Any:
        try:
            if order is not None:
                write(self._talk, order._asdict())
            answer = read(self._talk) if self._talk.poll(ANSWER_TIME) else f"no answer in {ANSWER_TIME:g} s"
        except (OSError, EOFError):
            answer = "it has ended"
        if isinstance(answer, str):
            raise SafetyStop(f"the monitor process refuses the motion: {answer}")
        return answer

    def refusal(self) -> str:
        """What the monitor process has reported unasked, after a semicolon; empty if nothing."""
        try:
            return f"; it says: {read(self._talk)}" if self._talk.poll() else ""
        except (OSError, EOFError):
            return "; it has ended"

    def sent(self, k: int, q: np.ndarray) -> None:
        """Pass on a command; `Guard` calls this for each one."""
        self._signs.sent(self._clock(), self.leg, k, q)

    @property
    def sees(self) -> bool:
        """Whether the monitor process has checked a reading of this stage."""
        return self._signs.looked_at > -np.inf

    def reason(self) -> str | None:
        """Why the guard must stop, or None: a finding of the monitor process, or its silence."""
        tripped = self._signs.tripped
        if tripped is not None:
            return f"the monitor process found: {tripped}"
        silent = self._clock() - self._signs.looked_at
        if self.sees and not silent <= self._silence:
            return f"the monitor process was silent for {1e3 * silent:.0f} ms, {1e3 * self._silence:.0f} ms are allowed"
        return None


@contextmanager
def seen(link: MonitorLink, make: Callable[[Callable[[int, np.ndarray], None]], Guard]) -> Iterator[Guard]:
    """The guard that `make` returns, entered, once the monitor process sees the arm; SafetyStop if not within SEEN_TIME."""
    with make(link.sent) as guard:
        for _ in range(round(SEEN_TIME / PAUSE)):
            guard.hold(PAUSE, "until the monitor process sees the arm")
            if link.sees:
                break
        else:
            raise SafetyStop(
                f"the monitor process saw no reading within {SEEN_TIME:g} s{link.refusal()}; check that a second program can read from the device"
            )
        yield guard
