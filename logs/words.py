"""Signed words that a recorder stored as unsigned ones: 65535 for -1."""

from __future__ import annotations

import numpy as np

BITS = {"int16": 16, "int32": 32}


def wrapped(x: np.ndarray) -> str | None:
    """Return the integer type whose negative values x (N,) holds as large positive ones; None if there is none.

    All values must be whole numbers in the lowest or the highest quarter of the unsigned range, with some in each. A load that
    changes sign leaves such a column; nothing that is measured does.
    """
    x = x[np.isfinite(x)]
    if not len(x) or np.any(x < 0) or np.any(x != np.rint(x)):
        return None
    for name, bits in BITS.items():
        if np.all(x < 2**bits):
            high = x >= 0.75 * 2**bits
            return name if bool(high.any() and np.all(high | (x < 0.25 * 2**bits)) and not high.all()) else None
    return None


def signed(x: np.ndarray, integer: str) -> np.ndarray:
    """x (N,) with the upper half of the word's range read as negative."""
    size = 2.0 ** BITS[integer]
    return np.where((x >= size / 2) & (x < size), x - size, x)


def finding(x: np.ndarray, integer: str) -> str:
    """Sentence that describes such a column."""
    x = x[np.isfinite(x)]
    half = 2.0 ** BITS[integer] / 2
    return (
        f"whole numbers from 0 to {np.max(x[x < half]):.0f} and from {np.min(x[x >= half]):.0f} to {np.max(x):.0f}, none between: "
        f"a signed {BITS[integer]}-bit word stored as unsigned ({2 * half - 1:.0f} is -1)"
    )
