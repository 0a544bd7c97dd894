"""The recordings of a finished stage are closed, whatever else fails."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from safety import execution
from sim.errors import DeviceError, SafetyStop


class _Closed:
    """Stands in for a recording."""

    def __init__(self, fails: bool) -> None:
        self.fails, self.reason = fails, ""

    def close(self, reason: str = "completed") -> None:
        self.reason = reason
        if self.fails:
            raise DeviceError("the disk is full")


@pytest.mark.parametrize(("disk", "monitor"), [(True, False), (False, True), (True, True)])
def test_every_recording_of_a_stage_is_closed_whatever_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, disk: bool, monitor: bool
) -> None:
    opened = dict[str, _Closed]()
    run = execution._Run.__new__(execution._Run)
    run.folder, run.progress, run.driver, run.monitored = tmp_path, SimpleNamespace(left=0.0), SimpleNamespace(rate=100.0), []  # type: ignore[assignment]

    def end() -> dict[str, float]:
        if monitor:
            raise SafetyStop("the monitor process has ended")
        return {}

    @contextmanager
    def guarded(legs: object) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(
            run=lambda *a: None,
            hold=lambda *a: None,
            monitor=SimpleNamespace(worst={"following error": np.zeros(6), "residual": np.zeros(6)}),
        )

    run.link = SimpleNamespace(leg=0, end=end)  # type: ignore[assignment]
    monkeypatch.setattr(run, "_recording", lambda path, name, speed: opened.setdefault(name, _Closed(disk and name == "a")))
    monkeypatch.setattr(run, "_guarded", guarded)
    legs = [SimpleNamespace(name=name, what=name, cleared=[0] * 10, first=0, last=9) for name in "ab"]
    with pytest.raises((DeviceError, SafetyStop)):
        run._stage(legs, 1.0)  # type: ignore[arg-type]
    assert [log.reason for log in opened.values()] == ["completed", "completed"]
