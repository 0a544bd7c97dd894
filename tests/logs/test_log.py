"""A recording as arrays: its parts, its joints in another order, its period."""

from __future__ import annotations

import math

import numpy as np
import pytest

from logs.log import CHANNELS, SAMPLES, Log

T = np.array([0.0, 0.01, 0.02, 0.05])
LOG = Log(("a", "b"), T, T + 1, *(np.arange(8.0).reshape(4, 2) + 10 * k for k in range(8)))


def test_a_part_has_the_same_rows_of_every_array() -> None:
    for rows in (slice(1, 3), np.array([False, True, True, False]), np.array([1, 2])):
        part = LOG.part(rows)
        assert len(part) == 2
        for name in SAMPLES:
            np.testing.assert_array_equal(getattr(part, name), getattr(LOG, name)[1:3])


def test_joints_in_another_order_take_every_column_along() -> None:
    turned = LOG.with_joints(["b", "a"])
    assert turned.joint_names == ("b", "a")
    for name in CHANNELS:
        np.testing.assert_array_equal(getattr(turned, name), getattr(LOG, name)[:, ::-1])
    assert LOG.with_joints(("b",)).q.shape == (4, 1)
    with pytest.raises(ValueError, match="not in tuple"):
        LOG.with_joints(("c",))


def test_the_period_is_that_of_most_steps() -> None:
    assert LOG.period == pytest.approx(0.01)
    assert math.isnan(LOG.part(slice(0, 1)).period)
