"""Interval arithmetic: the result contains every value that the operation can have for values of the operands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np


@dataclass(frozen=True, slots=True)
class Interval:
    """Every value from lo to hi, arrays of one shape."""

    lo: np.ndarray
    hi: np.ndarray

    @classmethod
    def around(cls, middle: np.ndarray, half: np.ndarray | float) -> Self:
        """middle - half to middle + half; half is not negative."""
        return cls(middle - half, middle + half)

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> Self:
        """Intervals that contain only zero."""
        return cls(np.zeros(shape), np.zeros(shape))

    @property
    def middle(self) -> np.ndarray:
        """(lo + hi) / 2."""
        return (self.lo + self.hi) / 2

    @property
    def half(self) -> np.ndarray:
        """(hi - lo) / 2."""
        return (self.hi - self.lo) / 2

    @property
    def magnitude(self) -> np.ndarray:
        """The largest |x|."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    def __getitem__(self, key: Any) -> Interval:
        return Interval(self.lo[key], self.hi[key])

    def __setitem__(self, key: Any, value: Interval) -> None:
        self.lo[key], self.hi[key] = value.lo, value.hi

    def __add__(self, other: Interval) -> Interval:
        return Interval(self.lo + other.lo, self.hi + other.hi)

    def __sub__(self, other: Interval) -> Interval:
        return Interval(self.lo - other.hi, self.hi - other.lo)

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __mul__(self, other: Interval) -> Interval:
        a, b, c, d = self.lo * other.lo, self.lo * other.hi, self.hi * other.lo, self.hi * other.hi
        return Interval(np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d)))

    def __abs__(self) -> Interval:
        least = np.maximum(np.maximum(self.lo, -self.hi), 0.0)
        return Interval(least, self.magnitude)

    def within(self, lo: float, hi: float) -> Interval:
        """Both bounds clipped to [lo, hi]."""
        return Interval(np.clip(self.lo, lo, hi), np.clip(self.hi, lo, hi))

    def hull(self, other: Interval) -> Interval:
        """The smallest interval that contains both."""
        return Interval(np.minimum(self.lo, other.lo), np.maximum(self.hi, other.hi))

    def wider(self, share: np.ndarray | float) -> Interval:
        """Each bound moved outwards by `share` of the largest |x|."""
        more = share * self.magnitude
        return Interval(self.lo - more, self.hi + more)

    def copy(self) -> Interval:
        """A copy with arrays of its own."""
        return Interval(self.lo.copy(), self.hi.copy())


def sine(x: Interval) -> Interval:
    """Bounds of sin(x): sin of the middle +- half the width of x, within [-1, 1]."""
    return Interval.around(np.sin(x.middle), np.minimum(x.half, 2.0)).within(-1.0, 1.0)
