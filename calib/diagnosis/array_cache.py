"""Arrays that were computed before: of all caches together, as many as fit into a number of bytes."""

from __future__ import annotations

import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np


class CacheBudget:
    """`most` bytes of arrays in all caches that share it: the least recently used go first, whichever cache they are in."""

    def __init__(self, most: float) -> None:
        self._most, self._bytes = most, 0
        self._sizes: OrderedDict[tuple[int, Hashable], int] = OrderedDict()
        self._owners: dict[int, dict[Hashable, Any]] = {}

    def joined_by(self, cache: object, values: dict[Hashable, Any]) -> None:
        """A new cache with its values; they are forgotten when it is."""
        self._owners[id(values)] = values
        weakref.finalize(cache, self._left_by, values).atexit = False

    def used(self, values: dict[Hashable, Any], key: Hashable) -> None:
        """That value is the last one to go."""
        self._sizes.move_to_end((id(values), key))

    def taken(self, values: dict[Hashable, Any], key: Hashable) -> None:
        """That value is new; others make room for it."""
        self._sizes[id(values), key] = _bytes(values[key])
        self._bytes += self._sizes[id(values), key]
        while self._bytes > self._most and len(self._sizes) > 1:
            (owner, dropped), size = self._sizes.popitem(last=False)
            self._bytes -= size
            self._owners.get(owner, {}).pop(dropped, None)  # its cache may go at any moment

    def _left_by(self, values: dict[Hashable, Any]) -> None:
        for key in values:
            self._bytes -= self._sizes.pop((id(values), key), 0)
        self._owners.pop(id(values), None)


# bytes, chosen between 80 and 110 MB on four cases of the exam (seed 26113061): with 110 no less time, and 23 to 56 MB more memory
SHARED = CacheBudget(80e6)

# bytes of motions of motors and their slips, which are small, quick to compute and many: among the others they would drive out what is neither
MOTIONS = CacheBudget(10e6)


class ArrayCache:
    """Values by key, within the budget."""

    def __init__(self, budget: CacheBudget = SHARED) -> None:
        self._budget = budget
        self._values: dict[Hashable, Any] = {}
        budget.joined_by(self, self._values)

    def of(self, key: Hashable, compute: Callable[[], Any]) -> Any:
        """The value under the key: an array, or an object with arrays as attributes; computed now where there is none."""
        if key in self._values:
            self._budget.used(self._values, key)
            return self._values[key]
        value = self._values[key] = compute()
        self._budget.taken(self._values, key)
        return value


def _bytes(value: Any) -> int:
    arrays = [value] if isinstance(value, np.ndarray) else vars(value).values()
    return sum(x.nbytes for x in arrays if isinstance(x, np.ndarray))
