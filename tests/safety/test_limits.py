"""Limits are verified at every instant: just inside passes, at the limit passes, just outside is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.limits import Excess, check_limits, check_sent, first_excess, halves, pieces, sampled
from sim.arm import Arm
from sim.errors import ConfigError, SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import sine


def dense(motion: Trajectory, steps: int = 50) -> tuple[np.ndarray, ...]:
    """Samples between samples from the quintic in the monomial basis: a reference independent of Bernstein forms."""
    q, dq, ddq, jerk = [], [], [], []
    s = np.linspace(0, 1, steps)
    rows = [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 2, 0, 0, 0], [1] * 6, [0, 1, 2, 3, 4, 5], [0, 0, 2, 6, 12, 20]]
    inverse = np.linalg.inv(np.array(rows, dtype=float))
    for k in range(len(motion) - 1):
        h = motion.t[k + 1] - motion.t[k]
        ends = [motion.q[k], h * motion.dq[k], h**2 * motion.ddq[k]]
        ends += [motion.q[k + 1], h * motion.dq[k + 1], h**2 * motion.ddq[k + 1]]
        c = inverse @ np.array(ends)
        powers = [np.array([np.prod([i - e for e in range(d)]) * s ** max(i - d, 0) for i in range(6)]) for d in range(4)]
        for d, out in enumerate((q, dq, ddq, jerk)):
            out.append(powers[d].T @ c / h**d)
    return tuple(np.concatenate(x) for x in (q, dq, ddq, jerk))


def test_pieces_hold_every_instant_and_touch_their_ends() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.01, 0.2, 40))
    motion = Trajectory(t, *rng.normal(size=(3, 40, 3)))
    form = pieces(motion)
    for b, values in zip((form.q, form.dq, form.ddq, form.jerk), dense(motion), strict=True):
        by_piece = values.reshape(len(b), -1, 3)
        slack = 1e-9 * np.abs(b).max()
        assert np.all(b.min(axis=1)[:, None] <= by_piece + slack)
        assert np.all(by_piece <= b.max(axis=1)[:, None] + slack)
        np.testing.assert_allclose(b[:, 0], by_piece[:, 0], rtol=1e-9, atol=slack)
        np.testing.assert_allclose(b[:, -1], by_piece[:, -1], rtol=1e-9, atol=slack)


def test_halves_are_the_same_polynomial() -> None:
    b = np.array([[0.0, 3.0, -1.0, 2.0]])
    left, right = halves(b)
    assert (left[0, 0], left[0, -1], right[0, 0], right[0, -1]) == (0.0, 1.0, 1.0, 2.0)


def limited(arm: Arm, name: str, value: np.ndarray) -> Arm:
    return replace(arm, **{name: value})


@pytest.mark.parametrize("name", ["dq_max", "ddq_max", "jerk_max"])
@pytest.mark.parametrize(("factor", "allowed"), [(1 + 1e-6, True), (1 - 1e-6, False)])
def test_each_limit_is_exact_to_a_millionth(arm: Arm, name: str, factor: float, allowed: bool) -> None:
    motion = sine(step=0.05)
    peaks = dict(zip(("q", "dq_max", "ddq_max", "jerk_max"), dense(motion, 2001), strict=True))
    strict = limited(arm, name, np.abs(peaks[name]).max(axis=0) * factor)
    if allowed:
        assert check_limits(motion, strict)
    else:
        with pytest.raises(SafetyStop, match=name.removesuffix("_max")):
            check_limits(motion, strict)


@pytest.mark.parametrize(("beyond", "allowed"), [(1e-6, True), (-1e-6, False)])
@pytest.mark.parametrize("side", ["q_min", "q_max"])
def test_position_limits_are_exact(arm: Arm, side: str, beyond: float, allowed: bool) -> None:
    motion = sine(step=0.05)
    q = dense(motion, 2001)[0]
    value = q.max(axis=0) + beyond if side == "q_max" else q.min(axis=0) - beyond
    strict = limited(arm, side, value)
    if allowed:
        check_limits(motion, strict)
    else:
        with pytest.raises(SafetyStop, match=r"j1: q .* rad leaves"):
            check_limits(motion, strict)


@pytest.mark.parametrize(("value", "allowed"), [(2.0, True), (np.nextafter(2.0, 3), False), (np.nextafter(2.0, 1), True)])
def test_a_sample_at_the_limit_passes_and_the_next_number_does_not(arm: Arm, value: float, allowed: bool) -> None:
    t = np.array([0.0, 0.1, 0.2])
    dq = np.zeros((3, 6))
    dq[:, 0] = value
    q = np.zeros((3, 6))
    q[:, 0] = value * t
    motion = Trajectory(t, q, dq, np.zeros((3, 6)))
    if allowed:
        assert check_limits(motion, arm)["dq"] == pytest.approx(1.0)
    else:
        with pytest.raises(SafetyStop, match="dq"):
            check_limits(motion, arm)


def test_an_excursion_between_two_samples_is_found(arm: Arm) -> None:
    """Both samples are far inside; the quintic between them is not."""
    t = np.array([0.0, 1.0])
    dq = np.zeros((2, 6))
    dq[:, 2] = [2.9, -2.9]
    q = np.zeros((2, 6))
    q[:, 2] = 2.5
    with pytest.raises(SafetyStop, match="j3: q"):
        check_limits(Trajectory(t, q, dq, np.zeros((2, 6))), arm)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_coefficients_that_are_not_finite_are_an_excess(bad: float) -> None:
    b = np.zeros((3, 4, 2))
    lo, hi = -np.ones(2), np.ones(2)
    assert first_excess(b, lo, hi) is None
    for i in range(4):
        wrong = b.copy()
        wrong[1, i, 1] = bad
        found = first_excess(wrong, lo, hi)
        assert found is not None
        assert (found.piece, found.joint) == (1, 1)


@pytest.mark.parametrize(
    ("b", "piece", "value"),
    [
        ([[0.0, 0.5, 1.5]], 0, 1.5),
        ([[-1.5, 0.0, 0.5]], 0, -1.5),
        ([[0.0, 1.2, 0.0], [0.0, 2.4, 0.0]], 1, 1.2),
        ([[0.0, -2.4, 0.0], [0.0, 1.2, 0.0]], 0, -1.2),
    ],
)
def test_the_excess_is_reported_where_it_is_reached(b: list[list[float]], piece: int, value: float) -> None:
    """The excess is at one end of a piece, or in the middle of one of two pieces that both have to be halved."""
    found = first_excess(np.array(b)[:, :, None], -np.ones(1), np.ones(1))
    assert found == Excess(piece, 0, value, True)


def test_what_cannot_be_decided_is_refused() -> None:
    """A peak above the limit by slightly more than the rounding tolerance is refused; a peak at the limit passes."""
    peak = 1 + 1.5e-9
    b = np.array([[[0.0], [2 * peak], [0.0]]])
    assert first_excess(b, -np.ones(1), np.ones(1)) is not None
    assert first_excess(b / peak, -np.ones(1), np.ones(1)) is None


def test_halving_ends_and_what_is_open_then_is_refused() -> None:
    """The peak at 1/3, which no halving hits, exceeds the tolerance by less than the last halving can resolve."""
    top = 1 + 1e-9 + 2e-14
    b = np.array([[[top - 1 / 9], [top + 2 / 9], [top - 4 / 9]]])
    found = first_excess(b, -np.ones(1), np.ones(1))
    assert found is not None
    assert not found.reached
    assert first_excess(b - 1e-12, -np.ones(1), np.ones(1)) is None


def test_a_missing_limit_is_requested(arm: Arm, motion: Trajectory) -> None:
    with pytest.raises(ConfigError, match="jerk_max of j2"):
        check_limits(motion, limited(arm, "jerk_max", np.array([1, np.nan, 1, 1, 1, 1])))


def test_another_number_of_joints_is_refused(arm: Arm) -> None:
    with pytest.raises(SafetyStop, match="5 joints"):
        check_limits(sine(5), arm)


def test_sampled_is_exact_at_samples_and_refuses_to_extrapolate(motion: Trajectory) -> None:
    same = sampled(motion, motion.t)
    np.testing.assert_array_equal(same.q, motion.q)
    np.testing.assert_allclose(same.ddq, motion.ddq, atol=1e-12)
    t = np.linspace(0, motion.t[-1], 997)
    fine = sampled(motion, t)
    np.testing.assert_allclose(np.gradient(fine.q[:, 0], t)[5:-5], fine.dq[5:-5, 0], atol=1e-4)
    with pytest.raises(ValueError, match="leave"):
        sampled(motion, np.array([0.0, motion.t[-1] + 1e-9]))


def test_samples_that_will_be_sent_are_checked_on_their_own(arm: Arm, motion: Trajectory) -> None:
    check_sent(motion, arm)
    for name, message in (("q", "q"), ("dq", "dq"), ("ddq", "ddq")):
        values = {key: np.array(getattr(motion, key)) for key in ("q", "dq", "ddq")}
        values[name][100, 3] += 50
        with pytest.raises(SafetyStop, match=rf"j4: {message} "):
            check_sent(Trajectory(motion.t, **values), arm)
    jump = np.array(motion.q)
    jump[200:, 5] += 0.5
    with pytest.raises(SafetyStop, match="j6: dq"):
        check_sent(Trajectory(motion.t, jump, motion.dq, motion.ddq), arm)
    check_sent(Trajectory(motion.t[:2], motion.q[:2], motion.dq[:2], motion.ddq[:2]), arm)
