"""Invalid numbers and arrays, made from valid ones."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import numpy as np

NUMBERS = (np.nan, np.inf, -np.inf)


def array(good: np.ndarray, rng: random.Random) -> Any:
    """The array with one non-finite element, or with another shape, or of another type."""
    kind = rng.randrange(10)
    if kind < 5:
        bad = np.array(good, dtype=float)
        bad.flat[rng.randrange(bad.size)] = rng.choice(NUMBERS)
        return bad
    others: list[Callable[[], Any]] = [
        lambda: good[:-1] if good.ndim == 1 else good[:, :-1],
        lambda: np.concatenate((good, good[-1:])),
        lambda: good[None],
        lambda: good.astype(complex) + 1j,
        lambda: good.astype(str),
        lambda: [None] * len(good),
        lambda: None,
        lambda: "0.1",
        lambda: [object()] * len(good),
        lambda: dict(enumerate(good.tolist())),
        lambda: good.astype(bool),
    ]
    return rng.choice(others)()


def number(rng: random.Random) -> Any:
    return rng.choice([*NUMBERS, None, "1.0", [1.0, 2.0], 1j, object()])
