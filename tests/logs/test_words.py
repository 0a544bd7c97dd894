"""Signed words stored as unsigned ones are found, and nothing else is taken for them."""

from __future__ import annotations

import numpy as np
import pytest

from logs.words import BITS, signed, wrapped


@pytest.mark.parametrize("integer", BITS)
def test_a_load_that_changes_its_sign(integer: str) -> None:
    x = np.rint(900 * np.sin(np.linspace(0, 9, 500)))
    kept = x % 2.0 ** BITS[integer]
    assert wrapped(kept) == integer
    np.testing.assert_array_equal(signed(kept, integer), x)


@pytest.mark.parametrize(
    "x",
    [
        [], [np.nan], [0.0], [65535.0], [0.0, 1.0, 3.0], [0.0, 30000.0, 65535.0], [0.5, 65535.0], [-1.0, 65535.0], [0.0, 65536.0],
        [65000.0, 65001.0], [0.0, 2.0**32], list(np.linspace(-4, 4, 9)),
    ],
)  # fmt: skip
def test_what_may_be_a_reading_as_it_is(x: list[float]) -> None:
    assert wrapped(np.array(x)) is None
