"""Verdicts and their exit codes from stated limits, joint by joint."""

from __future__ import annotations

import numpy as np
import pytest

from calib.verdict import GOOD_SHARE, Verdict, assess

NAMES = ("a", "b", "c", "d")
SIGNAL, MOST = np.full(4, 10.0), np.full(4, 100.0)
NAN = float("nan")


@pytest.mark.parametrize(
    ("left", "verdict", "code", "worst"),
    [
        ((0.05, 0.1, 0.19, 0.2), Verdict.GOOD, 0, "d"),
        ((0.05, 0.1, 0.21, 0.2), Verdict.POOR, 1, "c"),
        ((0.05, 0.1, 1.17, 0.2), Verdict.POOR, 1, "c"),
        ((0.05, 0.1, 1.17, 1.02), Verdict.WRONG_ARM, 2, "c"),
        ((NAN, NAN, 0.1, NAN), Verdict.GOOD, 0, "c"),
        ((NAN, NAN, 1.1, NAN), Verdict.WRONG_ARM, 2, "c"),
        ((NAN, NAN, NAN, NAN), Verdict.NOTHING, 2, None),
    ],
)
def test_the_worst_joint_decides(left: tuple[float, ...], verdict: Verdict, code: int, worst: str | None) -> None:
    found = assess(NAMES, np.array(left) * SIGNAL, SIGNAL, MOST)
    assert found.verdict is verdict
    assert found.verdict.exit_code == code
    claim = found.claim("arm", "the log")
    assert claim.numbers["worst"] == worst
    assert claim.numbers["verdict"] == verdict.value
    assert (worst or "nothing compared") in claim.sentence
    assert found.as_dict()["limits"]["good"] == GOOD_SHARE


def test_names_the_joints_that_nothing_was_compared_at() -> None:
    found = assess(NAMES, np.array([NAN, 0.1, NAN, 0.1]) * SIGNAL, SIGNAL, MOST)
    assert found.claim("arm", "the log").sentence.endswith("; not compared: a, c")
    assert "not compared" not in assess(NAMES, 0.1 * SIGNAL, SIGNAL, MOST).claim("arm", "the log").sentence


def test_a_joint_that_hardly_bears_anything_is_assessed_by_its_largest_torque() -> None:
    signal = np.array([10.0, 10.0, 10.0, 1.0])
    small = np.array([0.1, 0.1, 0.1, 0.45])
    assert assess(NAMES, small, signal, MOST).verdict is Verdict.GOOD
    assert assess(NAMES, small, signal, MOST, most=0.2).verdict is Verdict.POOR
    assert assess(NAMES, small, signal, np.full(4, np.inf)).verdict is Verdict.POOR


def test_max_error_is_the_limit_of_every_joint() -> None:
    residual = np.array([1.0, 3.0, 1.0, 1.0])
    assert assess(NAMES, residual, SIGNAL, MOST, most=0.3).verdict is Verdict.GOOD
    assert assess(NAMES, residual, SIGNAL, MOST, most=0.29).verdict is Verdict.POOR
    assert assess(NAMES, residual, SIGNAL, MOST, most=0.0).verdict is Verdict.POOR


def test_a_verdict_never_says_that_a_joint_is_beyond_a_limit_that_reads_the_same() -> None:
    residual = np.array([0.1, 0.2003, 0.1, 0.1]) * SIGNAL
    sentence = assess(NAMES, residual, SIGNAL, MOST, most=0.2).claim("arm", "the logs").sentence
    assert "20.03% of the torque std in the logs (limit 20.00%)" in sentence
