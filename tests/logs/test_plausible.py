"""Damaged samples: a jump of the position is damage, a burst of late stamps is not."""

from __future__ import annotations

import numpy as np
import pytest

from logs.plausible import bad_samples, first_fault


def motion(rate: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(800) / rate
    return t, 1.5 * np.sin(2.0 * t[:, None] + np.arange(3))


@pytest.mark.parametrize("apart", [0.0, 1e-6, 1e-4])
def test_a_burst_of_late_stamps_is_no_jump(apart: float) -> None:
    """A host stamps five samples together, whose positions are up to 30 mrad apart. The motion is valid."""
    t, q = motion()
    late = t.copy()
    for first in range(50, 750, 100):
        late[first : first + 5] = t[first + 4] + apart * np.arange(5)
    assert first_fault(late, {"q": q}) is None
    assert not bad_samples(late, {"q": q}).any()


def test_a_jump_is_one_whatever_the_stamps() -> None:
    t, q = motion()
    q[300:310] += 2.0
    fault = first_fault(t, {"q": q})
    assert fault is not None
    assert fault.sample == 300
    np.testing.assert_array_equal(np.flatnonzero(bad_samples(t, {"q": q})), np.arange(300, 310))
