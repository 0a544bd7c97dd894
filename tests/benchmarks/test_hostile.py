"""Any file is read or refused in one sentence, and nothing is written outside the requested folder."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from benchmarks.hostile import KINDS, attacked, names_that_leave


@cache
def all_attacked(count: int) -> dict[str, dict[str, Any]]:
    return attacked(1, count)


@pytest.mark.parametrize("count", [60, pytest.param(3000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_mutant_is_read_or_refused_in_a_sentence(kind: str, count: int) -> None:
    found = all_attacked(count)[kind]
    assert found["faults"] == []
    assert found["refused"] > count / 10
    assert found["peak"] < 1000


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_name_leaves_the_folder(count: int) -> None:
    outside, accepted = names_that_leave(count)
    assert outside == 0
    assert 0 < accepted < count
