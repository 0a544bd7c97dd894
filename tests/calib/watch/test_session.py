"""A watch from the first reading to the last: what it survives and what it writes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.watch.session import watch
from calib.watch.source import Source, from_log
from calib.watch.trend_table import TrendTable
from calib.watch.which_arm import WatchedArm
from logs import read_log
from sim.arm import Arm
from sim.joint_state import JointState


def source(arm: Arm, readings: Iterable[JointState], **changes: Any) -> Source:
    return replace(Source("a-cell", arm, 200.0, iter(readings), lambda: None, live=True), **changes)


@pytest.mark.parametrize("samples", [False, True])
@pytest.mark.parametrize("at", [0, 900])
def test_a_reading_without_an_instant_is_an_event_and_not_the_end(
    tmp_path: Path, servo6: Arm, calm: list[JointState], at: int, samples: bool
) -> None:
    readings = [replace(s, t_device=np.nan) if k == at else s for k, s in enumerate(calm[:1200])]
    found = watch(source(servo6, readings), tmp_path, samples=samples)
    assert found.fault is None
    assert [e.message.split(";")[0] for e in found.events] == ["device time is nan"]
    assert found.picture.samples == 1200
    assert len(read_log(tmp_path / "watch.mcap")) == (1199 if samples else 6)


MADE = datetime(2026, 1, 1, 8, tzinfo=UTC)


@pytest.mark.slow
@pytest.mark.parametrize("recorded", [MADE, None])
def test_what_a_watch_wrote_is_the_same_run_when_it_is_watched(
    tmp_path: Path, servo6: Arm, calm: list[JointState], recorded: datetime | None
) -> None:
    table = tmp_path / "t"
    given = source(servo6, calm, live=False, recording="digest", recorded=recorded, facts={"cell": "line-1", "serial": "17"})
    first, again = tmp_path / "first", tmp_path / "again"
    for folder in (first, again):
        folder.mkdir()
    assert watch(given, first, samples=True, database=table).kept
    assert watch(from_log(first / "watch.mcap"), again, database=table).kept
    with TrendTable(table) as kept:
        (run,) = kept.runs(WatchedArm("servo6", "line-1", "17"))
    assert run.source == "watch.mcap"
    assert run.recording == "digest"
    assert run.dated == ("recorded" if recorded else "watched")
    assert recorded is None or run.started == MADE


def test_a_live_watch_counts_once_with_what_it_wrote(tmp_path: Path, servo6: Arm, calm: list[JointState]) -> None:
    table = tmp_path / "t"
    for folder in ("first", "again", "later"):
        (tmp_path / folder).mkdir()
    watch(source(servo6, calm), tmp_path / "first", samples=True, database=table, now=lambda: MADE)
    watch(from_log(tmp_path / "first" / "watch.mcap"), tmp_path / "again", database=table)
    watch(source(servo6, calm), tmp_path / "later", database=table, now=lambda: MADE + timedelta(days=1))
    with TrendTable(table) as kept:
        assert [r.started for r in kept.runs(WatchedArm("servo6"))] == [MADE, MADE + timedelta(days=1)]
