"""Rules of the monitor on rows of their own: what they keep from reading to reading, and which joint they report."""

from __future__ import annotations

import numpy as np
import pytest

from safety import lies, rules
from safety.rows import ARM, NONE, NUMBERS, ROWS, Of, Row

TWO = 2


@pytest.fixture
def r() -> np.ndarray:
    return np.zeros((ROWS, TWO))


@pytest.fixture
def x() -> np.ndarray:
    return np.zeros(NUMBERS)


@pytest.fixture
def out() -> np.ndarray:
    return np.zeros(3)


def followed(r: np.ndarray, x: np.ndarray, out: np.ndarray, path: np.ndarray, q: float, command: float) -> int:
    r[Row.Q, 0], r[Row.Q_CMD, 0] = q, command
    broken = rules.following_error(r, x, path, out)
    x[Of.COUNT] += 1
    return int(broken)


def test_a_joint_may_be_anywhere_on_the_path_of_a_while_ago(r: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    """The command advances by 0.1 rad per cycle; the joint is 0.15 rad behind, on the second of the last three steps."""
    x[Of.ROOM], path = 0.01, np.zeros((3, 2 * TWO + 1))
    found = [followed(r, x, out, path, q, command) for q, command in ((0.0, 0.1), (0.05, 0.2), (0.15, 0.3))]
    assert found == [NONE, NONE, NONE]
    assert r[Row.WORST_ERROR, 0] == pytest.approx(0.0, abs=1e-12)
    # that step is no longer among the last three
    assert [followed(r, x, out, path, 0.05, command) for command in (0.4, 0.5)] == [0, 0]
    assert out[0] == pytest.approx(0.15)


def test_the_worst_following_error_is_kept_and_is_a_number(r: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    x[Of.ROOM], path = 1.0, np.zeros((1, 2 * TWO + 1))
    for q in (0.05, 0.3, 0.01, np.nan):
        followed(r, x, out, path, q, 0.0)
    assert r[Row.WORST_ERROR, 0] == pytest.approx(0.3)


def test_the_worst_residual_is_kept_and_is_a_number(r: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    r[Row.HAS_TAU], r[Row.TAU_MAX], r[Row.RESIDUAL] = 1.0, 10.0, 5.0
    found = []
    for tau in (0.5, 3.0, 1.0, np.nan):
        r[Row.TAU, 1] = tau
        found.append(rules.torque(r, x, out))
    assert found == [NONE, NONE, NONE, 1]
    assert r[Row.WORST_RESIDUAL].tolist() == pytest.approx([0.0, 0.3])


def test_the_mean_of_a_load_begins_at_the_first(r: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    x[Of.BLEND], x[Of.LOST_ROWS] = 0.1, 5.0
    means = []
    for load in (4.0, 6.0):
        r[Row.LOAD] = load
        rules.lost_load(r, x, out)
        means.append(float(r[Row.MEAN_LOAD, 0]))
    assert means == pytest.approx([4.0, 4.2])


def test_of_two_frozen_joints_the_first_is_reported(r: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    x[Of.FROZEN_LEAST], x[Of.FROZEN_MOST], x[Of.PERIOD], x[Of.GRAIN] = 3.0, 10.0, 0.002, 1e-4
    r[Row.DQ], r[Row.MOVING] = 0.5, 0.02
    found = []
    for k in range(1, 4):
        r[Row.Q_CMD] = 0.001 * k
        found.append(lies.frozen_position(r, x, out))
    assert found == [NONE, NONE, 0]


@pytest.mark.parametrize(
    ("noise", "expected", "found"),
    [
        (0.1, (0.0, 3.0, 6.0, 9.0), [NONE, NONE, NONE, 0]),
        (0.1, (0.0, 0.01, 0.02, 0.03), [NONE] * 4),  # the motion hardly changes the expected torque
        (0.0, (0.0, 3.0, 6.0, 9.0), [NONE] * 4),  # a sensor without noise repeats itself
    ],
)
def test_a_torque_is_frozen_that_repeats_itself_while_another_is_expected(
    r: np.ndarray, x: np.ndarray, out: np.ndarray, noise: float, expected: tuple[float, ...], found: list[int]
) -> None:
    x[Of.EXPECTED], x[Of.CHANGED] = 1.0, 3.0
    r[Row.HAS_TAU], r[Row.NOISE], r[Row.DQ], r[Row.MOVING], r[Row.TAU], r[Row.LAST_TAU] = 1.0, noise, 0.5, 0.02, 2.5, np.nan
    answers = []
    for tau_hat in expected:
        r[Row.TAU_HAT] = tau_hat
        answers.append(lies.frozen_torque(r, x, 3, out))
    assert answers == found


def swung(r: np.ndarray, x: np.ndarray, out: np.ndarray, hats: tuple[float, ...], tau: float = 0.0) -> list[int]:
    found = []
    for tau_hat in hats:
        r[Row.TAU_HAT], r[Row.TAU] = tau_hat, tau
        found.append(int(lies.swing(r, x, out)))
    return found


@pytest.fixture
def swinging(r: np.ndarray, x: np.ndarray) -> np.ndarray:
    x[Of.EXPECTED], x[Of.ANY_TAU], x[Of.SWING_ROWS], x[Of.FOLLOWS], x[Of.SIGMAS] = 1.0, 1.0, 3.0, 0.2, 4.0
    r[Row.HAS_TAU] = 1.0
    lies.clear_swing(r, x)
    return x


def test_a_torque_that_does_not_swing_is_found_at_the_first_joint_and_once(
    r: np.ndarray, swinging: np.ndarray, out: np.ndarray
) -> None:
    assert swung(r, swinging, out, (0.0, 5.0, 10.0)) == [NONE, NONE, 0]
    assert out.tolist() == pytest.approx([0.0, 2.0, 10.0])
    assert swung(r, swinging, out, (10.0, 10.0, 10.0)) == [NONE] * 3


@pytest.mark.parametrize(("row", "value"), [(Row.HAS_TAU, 0.0), (Row.DOUBT, 5.5), (Row.NOISE, 1.5)])
def test_what_is_not_known_of_a_torque_is_no_swing(
    r: np.ndarray, swinging: np.ndarray, out: np.ndarray, row: Row, value: float
) -> None:
    r[row] = value
    assert swung(r, swinging, out, (0.0, 5.0, 10.0)) == [NONE] * 3


def test_a_torque_that_follows_is_none(r: np.ndarray, swinging: np.ndarray, out: np.ndarray) -> None:
    assert swung(r, swinging, out, (0.0, 5.0)) == [NONE] * 2
    assert swung(r, swinging, out, (10.0,), tau=2.5) == [NONE]


@pytest.mark.parametrize("missing", [Of.EXPECTED, Of.ANY_TAU])
def test_a_reading_without_expectation_or_torque_begins_the_swing_anew(
    r: np.ndarray, swinging: np.ndarray, out: np.ndarray, missing: Of
) -> None:
    assert swung(r, swinging, out, (0.0, 10.0)) == [NONE] * 2
    swinging[missing] = 0.0
    assert swung(r, swinging, out, (5.0,)) == [NONE]
    assert swinging[Of.SWING_SEEN] == 0
    swinging[missing] = 1.0
    assert swung(r, swinging, out, (5.0, 5.0, 5.0)) == [NONE] * 3


def test_a_device_clock_may_have_begun_at_any_time(r: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    """Later blocks of arrivals are compared with the first."""
    x[Of.BLOCK], x[Of.DRIFT], x[Of.JITTER], x[Of.BLOCK_LEAST], x[Of.BLOCK_END] = 1.0, 5e-4, 3e-3, np.inf, 51.0
    found = []
    for t_device, late in ((50.5, 0.01), (51.0, 0.0), (51.5, 0.002), (52.0, 0.0), (53.0, 0.0051)):
        x[Of.T_DEVICE], x[Of.T] = t_device, t_device + 700.0 + late
        found.append(lies.clock(r, x, out))
    assert found == [NONE, NONE, NONE, NONE, ARM]
    assert out[:2].tolist() == pytest.approx([0.0051, 5e-4 * 2 + 3e-3])
