"""Checks for finite real numbers: text, bools, complex numbers and None are not numbers; NaN and infinities are not finite."""

from __future__ import annotations

from typing import Any

import numpy as np


def real_array(values: Any, what: str) -> np.ndarray:
    """`values` as a new float array of the same shape, NaN and infinities included; ValueError unless they are real numbers."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{what} holds {array.dtype}, not real numbers: give floats")
    return array.astype(float)


def is_finite(values: Any, *shape: int) -> bool:
    """Whether `values` is an array of finite real numbers of this shape; NaN, text, None or another length is not."""
    return (
        isinstance(values, np.ndarray)
        and values.dtype.kind in "fiu"
        and values.shape == shape
        and bool(np.isfinite(values).all())
    )
