"""Only a joint with a law gets one, and structure in a single part is not a law."""

from __future__ import annotations

import numpy as np
import pytest

from calib.regression.friction_fit import HELPS, Part, fit_friction

ROWS, P, K = 400, 5, 8
TRUE = np.array([0.0, 1.5, 0.0, 0.0, -0.7, 0.0, 0.0, 0.0])


def parts(seed: int, only_in: int | None = None, law: float = 1.0) -> tuple[list[Part], np.ndarray]:
    """Four recordings of two joints with shared parameters; the law is at joint 0, in all parts or in one."""
    rng = np.random.default_rng(seed)
    theta, out = rng.standard_normal(P), []
    for k in range(4):
        x = [rng.standard_normal((ROWS, P)) for _ in range(2)]
        d = [rng.standard_normal((ROWS, K)) for _ in range(2)]
        r = [a @ theta + 0.5 * rng.standard_normal(ROWS) for a in x]
        if only_in is None or only_in == k:
            r[0] = r[0] + law * d[0] @ TRUE
        out.append(Part(x, d, r))
    return out, theta


@pytest.mark.parametrize("seed", range(4))
def test_the_law_is_found_where_it_is(seed: int) -> None:
    data, theta = parts(seed)
    found = fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [range(3), range(K)])
    assert found.joints == [0]
    np.testing.assert_allclose(found.coefficients[0], TRUE, atol=0.1)
    np.testing.assert_allclose(found.theta, theta, atol=0.1)
    assert found.predicted[0] == pytest.approx(0.5, rel=0.1)
    assert found.plain[0] > 2 * found.predicted[0]
    # the stated covariance matches the noise: parameters lie within five of their standard deviations
    assert np.all(np.abs(found.theta - theta) < 5 * np.sqrt(np.diag(found.covariance)))


@pytest.mark.parametrize("seed", range(6))
def test_noise_has_no_law(seed: int) -> None:
    data, _ = parts(seed, law=0.0)
    found = fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [range(3), range(K)])
    assert found.joints == []
    np.testing.assert_allclose(found.plain, 0.5, rtol=0.1)


def test_what_one_recording_has_and_the_others_have_not_is_no_law() -> None:
    data, _ = parts(1, only_in=2)
    assert fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [range(K)]).joints == []


def test_only_the_joints_that_are_requested() -> None:
    data, _ = parts(1)
    assert fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [range(K)], only=[1]).joints == []


def test_one_recording_is_cut_into_parts() -> None:
    data, _ = parts(5)
    found = fit_friction(data[:1], np.zeros(P), 1e-6 * np.eye(P), [range(K)])
    assert found.joints == [0]
    assert found.predicted[0] < (1 - HELPS) * found.plain[0]


def test_a_prior_holds_what_the_rows_do_not_show() -> None:
    data, _ = parts(3)
    blind = [Part([np.where(np.arange(P) == 2, 0.0, x) for x in p.x], p.d, p.r) for p in data]
    mean = np.full(P, 7.0)
    found = fit_friction(blind, mean, 1e-4 * np.eye(P), [])
    assert found.theta[2] == pytest.approx(7.0)
    assert np.abs(found.theta[[0, 1, 3, 4]] - 7.0).min() > 1.0


def test_a_joint_that_was_not_requested_gets_no_law_though_the_law_of_another_helps_it() -> None:
    rng = np.random.default_rng(11)
    data = []
    for _ in range(4):
        x, d = [rng.normal(size=(400, P)) for _ in range(2)], [rng.normal(size=(400, K)) for _ in range(2)]
        d[0][:, 0] = x[0][:, 0] + 0.02 * rng.normal(size=400)  # without its law, joint 0 pulls the shared parameter away
        r = [x[j] @ np.ones(P) + noise * rng.normal(size=400) for j, noise in enumerate((0.2, 5.0))]
        r[0] = r[0] + 20.0 * d[0][:, 0]
        data.append(Part(x, d, r))
    free = fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [])
    found = fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [range(K)], only=[0])
    assert found.joints == [0]
    assert found.predicted[1] < (1 - HELPS) * free.plain[1]


def test_a_joint_whose_torque_reads_zero_spoils_no_other() -> None:
    data, theta = parts(2, law=0.0)
    silent = [Part(p.x, p.d, [p.r[0], np.zeros(ROWS)]) for p in data]
    for p in silent:
        p.x[1][:] = 0.0
        p.d[1][:] = 0.0
    with np.errstate(all="raise"):
        found = fit_friction(silent, np.zeros(P), 1e-6 * np.eye(P), [range(K)])
    np.testing.assert_allclose(found.theta, theta, atol=0.15)


@pytest.mark.parametrize(("count", "expected"), [(3, []), (4, [0])])
def test_one_recording_without_the_law_is_excepted_only_among_four_or_more(count: int, expected: list[int]) -> None:
    """The last recording lacks the law but the error falls on average."""
    data, _ = parts(2)
    other, _ = parts(2, law=0.0)
    data = [*data[: count - 1], other[3]]
    found = fit_friction(data, np.zeros(P), 1e-6 * np.eye(P), [range(K)])
    assert found.joints == expected


def test_recordings_in_which_the_joint_stands_neither_support_nor_refute_its_law() -> None:
    """Joint 0 has rows in two of four recordings."""
    data, _ = parts(3)
    still = [
        Part([p.x[0][:0], p.x[1]], [p.d[0][:0], p.d[1]], [p.r[0][:0], p.r[1]]) if k >= 2 else p for k, p in enumerate(data)
    ]
    assert fit_friction(still, np.zeros(P), 1e-6 * np.eye(P), [range(K)]).joints == [0]
