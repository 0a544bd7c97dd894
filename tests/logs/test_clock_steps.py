"""A clock that was set forward leaves a gap in the stamps but not in the motion; lost samples leave a gap in both."""

from pathlib import Path

import numpy as np
import pytest

from logs.clock_steps import set_forward
from logs.damage import Damage
from logs.timing import checked_times

PERIOD, PLACE = 0.002, 1500


def motion(t: np.ndarray, amplitude: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """q and dq (N, 2) of two joints, with measurement noise."""
    noise = np.random.default_rng(5).standard_normal((2, len(t), 2))
    w = np.array([2.0, 3.1])
    phase = w * t[:, None] + [0.3, 1.0]
    return amplitude * np.sin(phase) + 1e-5 * noise[0], amplitude * w * np.cos(phase) + 1e-3 * noise[1]


def found(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    return set_forward(t, q, dq, np.flatnonzero(np.diff(t) > 2.5 * PERIOD))


def after(k: int) -> np.ndarray:
    return np.arange(4000) > k


@pytest.mark.parametrize("by", [0.006, 0.5, 3600.0])
def test_a_clock_set_forward_is_named_with_its_step(by: float) -> None:
    t = PERIOD * np.arange(4000)
    q, dq = motion(t)
    stamps = t + by * after(PLACE)
    np.testing.assert_allclose(found(stamps, q, dq), [by])
    damage = Damage(Path("a.csv"))
    checked_times(stamps, np.full(4000, np.nan), damage, (q, dq))
    assert len(damage.findings) == 1
    assert damage.findings[0].startswith(f"the clock was set forward by {by:.3g} s at {t[PLACE]:.3f} s: ")
    assert "no sample is missing" in damage.findings[0]


@pytest.mark.parametrize("lost", [3, 4, 20, 250, 1000])
@pytest.mark.parametrize("place", [1000, 1200, 1500, 1800])
def test_lost_samples_are_no_clock_that_was_set(lost: int, place: int) -> None:
    t = PERIOD * np.arange(4000)
    keep = (np.arange(4000) <= place) | (np.arange(4000) > place + lost)
    q, dq = motion(t)
    assert not found(t[keep], q[keep], dq[keep]).any()
    damage = Damage(Path("a.csv"))
    checked_times(t[keep], np.full(keep.sum(), np.nan), damage, (q[keep], dq[keep]))
    assert damage.findings == [
        f"1 gap of more than 2.5 sample periods, the longest {1e3 * PERIOD * (lost + 1):.1f} ms at {t[place]:.4f} s; "
        f"about {lost} samples are missing"
    ]


@pytest.mark.parametrize("what", ["slow", "no speeds", "speeds in another unit", "standing"])
def test_a_motion_that_cannot_tell_claims_nothing(what: str) -> None:
    t = PERIOD * np.arange(4000)
    q, dq = motion(t, 1e-3 if what == "slow" else 0.5)
    dq = {"no speeds": np.full_like(dq, np.nan), "speeds in another unit": dq * 57.3}.get(what, dq)
    if what == "standing":
        near = np.abs(np.arange(4000) - PLACE) < 100
        q[near], dq[near] = q[PLACE], 0.0
    assert not found(t + 0.5 * after(PLACE), q, dq).any()
