"""What guard and monitor process show each other: numbers and a sentence in shared memory, no lock to wait for.

Each value is written by one side only. What belongs together is read again where it was written meanwhile; a sentence is written before
the flag that says that there is one.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np

# what the guard does where it sends no sample of a motion
HOLDS, STOPS, ENDED = -1, -2, -3

TEXT = 400
TURN_AT, SENT_AT, LEG_AT, K_AT, LOOKED_AT, TRIPPED_AT, NUMBERS = range(7)
# times that a pair of numbers is read again before the reading is given up: the writer takes microseconds
TRIES = 1000


class Sign(NamedTuple):
    """The guard's last sign of life: at s of the host's clock, leg of the stage, sample k of it or HOLDS, STOPS, ENDED, command q (n,) rad."""

    at: float
    leg: int
    k: int
    q: np.ndarray


class Signs:
    """Shared memory for an arm of n joints, made before both processes start and handed to them; context: of `multiprocessing`."""

    def __init__(self, n: int, context: Any) -> None:
        self._n = n
        self._memory = context.RawArray(ctypes.c_double, NUMBERS + n)
        self._text = context.RawArray(ctypes.c_char, TEXT)
        self._numbers = np.frombuffer(self._memory)
        self._numbers[K_AT], self._numbers[LOOKED_AT] = ENDED, -np.inf

    def __getstate__(self) -> tuple[Any, ...]:
        return self._n, self._memory, self._text

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._n, self._memory, self._text = state
        self._numbers = np.frombuffer(self._memory)

    def sent(self, at: float, leg: int, k: int, q: np.ndarray) -> None:
        """The guard: what was sent at s of the host's clock."""
        numbers = self._numbers
        numbers[TURN_AT] += 1
        numbers[SENT_AT], numbers[LEG_AT], numbers[K_AT], numbers[NUMBERS:] = at, leg, k, q
        numbers[TURN_AT] += 1

    def last(self) -> Sign:
        """What the guard showed last, of one piece; where it was being written all the time, what cannot be right: a sign of no time."""
        for _ in range(TRIES):
            before = self._numbers.copy()
            if before[TURN_AT] % 2 == 0 and self._numbers[TURN_AT] == before[TURN_AT]:
                return Sign(float(before[SENT_AT]), int(before[LEG_AT]), int(before[K_AT]), before[NUMBERS:])
        return Sign(-np.inf, -1, ENDED - 1, np.full(self._n, np.nan))

    def looked(self, at: float) -> None:
        """The monitor process: it has checked a reading at s of the host's clock."""
        self._numbers[LOOKED_AT] = at

    @property
    def looked_at(self) -> float:
        """When the monitor process last checked a reading; -inf before its first."""
        return float(self._numbers[LOOKED_AT])

    def trip(self, reason: str) -> None:
        """The monitor process wants a stop; the first reason stays."""
        if self.tripped is None:
            self._text.raw = reason.encode()[: TEXT - 1].ljust(TEXT, b"\0")
            self._numbers[TRIPPED_AT] = 1.0

    @property
    def tripped(self) -> str | None:
        """Why the monitor process wants a stop, or None."""
        return str(self._text.value.decode(errors="replace")) if self._numbers[TRIPPED_AT] else None
