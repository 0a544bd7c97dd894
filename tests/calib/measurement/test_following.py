from __future__ import annotations

import numpy as np
import pytest

from calib.measurement.following import LEAST_BLOCKS, jackknifed
from calib.measurement.observed import Observed, clear, together
from sim.effects import effect_named


def correlated(rng: np.random.Generator, count: int) -> np.ndarray:
    out = np.zeros(count)
    for k, x in enumerate(rng.standard_normal(count)):
        out[k] = 0.95 * out[k - 1] + x
    return out


def test_the_deviation_is_that_of_repeated_measurements() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(0, 20, 0.02)
    x = np.column_stack([np.ones(len(t)), np.sign(np.sin(1.3 * t))])
    found = [jackknifed(x, x @ [0.3, 2.0] + correlated(rng, len(t)), t.astype(int)) for _ in range(60)]
    value, std = np.array([(o.value, o.std) for o in found if o is not None]).T
    assert len(value) == 60
    assert abs(value.mean() - 2.0) < 4 * value.std() / np.sqrt(60)
    assert 0.8 < std.mean() / value.std() < 2.0


def test_a_few_seconds_show_nothing() -> None:
    block = np.repeat(np.arange(LEAST_BLOCKS - 1), 50)
    x = np.column_stack([np.ones(len(block)), np.sign(np.sin(np.arange(len(block))))])
    assert jackknifed(x, x[:, 1].copy(), block) is None


def test_recordings_are_weighed_by_their_information_and_nothing_counts_that_is_not_clear() -> None:
    key = ("backlash", "elbow_joint")
    parts = [{key: Observed(1.0, 0.1)}, {key: Observed(2.0, 0.2)}, {}]
    both = together(parts)[key]
    assert both.value == pytest.approx(1.2)
    assert both.std == pytest.approx(1 / np.sqrt(125))
    assert clear(parts) == {key: both}
    assert clear([{key: Observed(0.2, 0.1)}]) == {}
    assert clear([{key: Observed(-2.0, 0.1)}]) == {}


def test_a_motor_leads_by_the_sign_of_the_load() -> None:
    lead = effect_named("backlash").motor_lead(np.array([-4.0, 0.01, 5.0]))
    assert lead is not None
    assert lead[[0, 2]].tolist() == [-1.0, 1.0]
    assert np.isnan(lead[1])
    assert effect_named("joint_elasticity").motor_lead(np.ones(3)) is None
