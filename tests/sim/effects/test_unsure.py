"""An uncertain gain or delay of the torque reading widens the bounds of the verified torque."""

from __future__ import annotations

import numpy as np
import pytest

from sim.effects import effect_named
from sim.interval import Interval
from sim.torque_box import TorqueBox

T = np.linspace(0.0, 1.0, 101)


def reading(effect: str, parameter: str, value: float, unsure: float) -> Interval:
    """Bounds (101, 1) N m on the reading of a torque that rises from 10 N m by 10 N m/s."""
    still = Interval.zeros((len(T), 1))
    box = TorqueBox.of(still.copy(), still.copy(), still.copy(), np.array([1.0]), np.array([100.0]), 0.0, T)
    box.reading = Interval.around(10.0 + 10.0 * T[:, None], 0.0)
    known = {parameter: Interval.around(np.array([value]), 0.0)}
    effect_named(effect).bound(box, np.array([0]), known, np.array([unsure]))
    return box.reading


def test_a_gain_is_unsure_by_a_share_of_what_it_differs_from_one() -> None:
    sure, unsure = (reading("torque_gain", "gain", 1.2, share) for share in (0.0, 0.5))
    np.testing.assert_allclose(sure.half, 0.0, atol=1e-12)
    assert (unsure.lo[0, 0], unsure.hi[0, 0]) == (pytest.approx(11.0), pytest.approx(13.0))
    np.testing.assert_allclose(reading("torque_gain", "gain", 1.0, 0.5).half, 0.0, atol=1e-12)


def test_a_delay_is_unsure_by_a_share_of_itself() -> None:
    sure, unsure = (reading("time_delay", "delay", 0.04, share) for share in (0.0, 0.5))
    np.testing.assert_allclose(sure.half[10:], 0.0, atol=1e-12)
    np.testing.assert_allclose(unsure.half[10:], 0.2, atol=1e-9)
