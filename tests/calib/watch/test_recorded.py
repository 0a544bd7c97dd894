"""The date of a recording, and how a recording is recognised again."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.watch.recorded import digest_of, instant_of
from logs.log import Log
from sim.errors import BadLog
from tests.calib.watch.conftest import START


def log(**about: Any) -> Log:
    values = np.arange(12.0).reshape(6, 2)
    fields = dict.fromkeys(("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd"), values)
    given = {"joint_names": ("a", "b"), "t": np.arange(6.0), "t_host": np.full(6, np.nan), **fields, **about}
    return Log(**given)


NEW_YEAR = 1_767_225_600 * 10**9  # ns, 2026-01-01


@pytest.mark.parametrize(
    ("about", "expected"),
    [
        ({"metadata": {"wall_clock_start_ns": str(NEW_YEAR)}, "t_origin": 100 * 10**9}, START),
        ({"t_host": np.arange(6.0), "t_host_origin": NEW_YEAR}, START),
        ({"t_host_origin": NEW_YEAR}, None),  # a log without a host clock
        ({"t_origin": NEW_YEAR}, START),  # a table with times since 1970
        ({"t_origin": 100 * 10**9}, None),  # seconds since the controller was switched on
        ({"metadata": {"wall_clock_start_ns": "17"}, "t_origin": NEW_YEAR}, START),  # a host whose clock was not set
    ],
)
def test_a_recording_is_dated_by_what_it_states(about: dict[str, Any], expected: datetime | None) -> None:
    assert instant_of(log(**about)) == expected


def test_a_wall_clock_that_is_no_number_is_refused() -> None:
    with pytest.raises(BadLog, match="wall_clock_start_ns = 'yesterday' is not a time"):
        instant_of(log(metadata={"wall_clock_start_ns": "yesterday"}))


@pytest.mark.parametrize("stated", ["yesterday", "2026-01-01", "2026-13-01T00:00:00+00:00", "9999-12-31T23:59:59-23:00"])
def test_a_watch_whose_source_is_dated_by_no_date_is_refused(stated: str) -> None:
    with pytest.raises(BadLog, match=f"recorded = '{re.escape(stated)}' is not a date from 2000 to 2099 with a time zone"):
        instant_of(log(metadata={"recorded": stated}))


def test_a_recording_is_known_by_its_samples() -> None:
    assert digest_of(log(path=Path("a.mcap"))) == digest_of(log(path=Path("b/c.mcap")))
    assert digest_of(log()) != digest_of(log(q=np.ones((6, 2))))
    assert digest_of(log(t_origin=NEW_YEAR)) != digest_of(log())
