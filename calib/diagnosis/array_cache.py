"""Arrays that were computed before, as many as fit into a number of bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np


class ArrayCache:
    """Values by key, at most `most` bytes of arrays together: the least recently used go first."""

    def __init__(self, most: float) -> None:
        self._most, self._bytes = most, 0
        self._values: OrderedDict[Hashable, Any] = OrderedDict()

    def of(self, key: Hashable, compute: Callable[[], Any]) -> Any:
        """The value under the key: an array, or an object with arrays as attributes; computed now where there is none."""
        if key in self._values:
            self._values.move_to_end(key)
            return self._values[key]
        value = self._values[key] = compute()
        self._bytes += _bytes(value)
        while self._bytes > self._most and len(self._values) > 1:
            _, dropped = self._values.popitem(last=False)
            self._bytes -= _bytes(dropped)
        return value


def _bytes(value: Any) -> int:
    arrays = [value] if isinstance(value, np.ndarray) else vars(value).values()
    return sum(x.nbytes for x in arrays if isinstance(x, np.ndarray))
