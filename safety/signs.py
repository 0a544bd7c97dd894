"""Shared memory between guard and monitor process: numbers and a sentence, without locks.

Each value has one writer. Numbers that belong together are read again if they were written meanwhile. A sentence is written
before the flag that announces it.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np

# what the guard does when it sends no sample of a motion
HOLDS, STOPS, ENDED = -1, -2, -3

TEXT = 400
TURN_AT, SENT_AT, LEG_AT, K_AT, LOOKED_AT, TRIPPED_AT, HALTED_AT, NUMBERS = range(8)
# attempts to read the numbers consistently before giving up; writing them takes microseconds
TRIES = 1000


class Sign(NamedTuple):
    """The guard's last sign of life: s on the host's clock, leg, its sample k or HOLDS, STOPS, ENDED, command q (n,) rad."""

    at: float
    leg: int
    k: int
    q: np.ndarray


class Signs:
    """Shared memory for an arm of n joints, created before both processes and passed to them; context: of `multiprocessing`."""

    def __init__(self, n: int, context: Any) -> None:
        self._n = n
        self._memory = context.RawArray(ctypes.c_double, NUMBERS + n)
        self._text, self._refusal = (context.RawArray(ctypes.c_char, TEXT) for _ in range(2))
        self._numbers = np.frombuffer(self._memory)
        self._numbers[K_AT], self._numbers[LOOKED_AT] = ENDED, -np.inf

    def __getstate__(self) -> tuple[Any, ...]:
        return self._n, self._memory, self._text, self._refusal

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._n, self._memory, self._text, self._refusal = state
        self._numbers = np.frombuffer(self._memory)

    def sent(self, at: float, leg: int, k: int, q: np.ndarray) -> None:
        """Guard: record what was sent, and when, s on the host's clock."""
        numbers = self._numbers
        numbers[TURN_AT] += 1
        numbers[SENT_AT], numbers[LEG_AT], numbers[K_AT], numbers[NUMBERS:] = at, leg, k, q
        numbers[TURN_AT] += 1

    def last(self) -> Sign:
        """The guard's last sign, read consistently; if it is being written all the time, an invalid one with time -inf."""
        for _ in range(TRIES):
            before = self._numbers.copy()
            if before[TURN_AT] % 2 == 0 and self._numbers[TURN_AT] == before[TURN_AT]:
                return Sign(float(before[SENT_AT]), int(before[LEG_AT]), int(before[K_AT]), before[NUMBERS:])
        return Sign(-np.inf, -1, ENDED - 1, np.full(self._n, np.nan))

    def looked(self, at: float) -> None:
        """Monitor process: record when it checked a reading, s on the host's clock."""
        self._numbers[LOOKED_AT] = at

    @property
    def looked_at(self) -> float:
        """When the monitor process last checked a reading, s; -inf before its first."""
        return float(self._numbers[LOOKED_AT])

    def trip(self, reason: str) -> None:
        """Monitor process: request a stop; the first reason stays."""
        if self.tripped is None:
            self._text.raw = _bytes(reason)
            self._numbers[TRIPPED_AT] = 1.0

    @property
    def tripped(self) -> str | None:
        """Why the monitor process requests a stop, or None."""
        return str(self._text.value.decode(errors="replace")) if self._numbers[TRIPPED_AT] else None

    def halted(self, refusal: str = "") -> None:
        """Monitor process: record that the device accepted its stop, or why it did not."""
        self._refusal.raw = _bytes(refusal)
        self._numbers[HALTED_AT] = 1.0

    @property
    def halt(self) -> str | None:
        """Outcome of the monitor process's own stop: empty if the device accepted it, else why not; None without an outcome."""
        return str(self._refusal.value.decode(errors="replace")) if self._numbers[HALTED_AT] else None


def _bytes(text: str) -> bytes:
    return text.encode()[: TEXT - 1].ljust(TEXT, b"\0")
