"""Caches of computed arrays that share one memory budget."""

from __future__ import annotations

import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np


class CacheBudget:
    """At most `most` bytes of arrays in all caches that share it; the least recently used goes first, from any cache."""

    def __init__(self, most: float) -> None:
        self._most, self._bytes = most, 0
        self._sizes: OrderedDict[tuple[int, Hashable], int] = OrderedDict()
        self._owners: dict[int, dict[Hashable, Any]] = {}

    def joined_by(self, cache: object, values: dict[Hashable, Any]) -> None:
        """Add a cache and its values; they are forgotten when the cache is."""
        self._owners[id(values)] = values
        weakref.finalize(cache, self._left_by, values).atexit = False

    def used(self, values: dict[Hashable, Any], key: Hashable) -> None:
        """Mark a value as the most recently used."""
        self._sizes.move_to_end((id(values), key))

    def taken(self, values: dict[Hashable, Any], key: Hashable) -> None:
        """Count a new value and drop others to make room for it."""
        self._sizes[id(values), key] = _bytes(values[key])
        self._bytes += self._sizes[id(values), key]
        while self._bytes > self._most and len(self._sizes) > 1:
            (owner, dropped), size = self._sizes.popitem(last=False)
            self._bytes -= size
            self._owners.get(owner, {}).pop(dropped, None)  # its cache may be collected at any moment

    def _left_by(self, values: dict[Hashable, Any]) -> None:
        for key in values:
            self._bytes -= self._sizes.pop((id(values), key), 0)
        self._owners.pop(id(values), None)


# bytes; chosen between 80 and 110 MB on four exam cases (seed 26113061): 110 MB saved no time and took 23 to 56 MB more memory
SHARED = CacheBudget(80e6)

# bytes for motor motions and their slips, which are small, quick to compute and many: in the shared budget they would displace
# arrays that are neither small nor quick
MOTIONS = CacheBudget(10e6)


class ArrayCache:
    """Values by key, within a budget."""

    def __init__(self, budget: CacheBudget = SHARED) -> None:
        self._budget = budget
        self._values: dict[Hashable, Any] = {}
        budget.joined_by(self, self._values)

    def of(self, key: Hashable, compute: Callable[[], Any]) -> Any:
        """The value under the key, computed if missing: an array, or an object with arrays as attributes."""
        if key in self._values:
            self._budget.used(self._values, key)
            return self._values[key]
        value = self._values[key] = compute()
        self._budget.taken(self._values, key)
        return value


def _bytes(value: Any) -> int:
    arrays = [value] if isinstance(value, np.ndarray) else vars(value).values()
    return sum(x.nbytes for x in arrays if isinstance(x, np.ndarray))
