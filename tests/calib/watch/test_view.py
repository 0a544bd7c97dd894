"""The screen of a watch cuts no number when narrow, and shows none before anything was measured."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest
from rich.console import Console

from calib.watch.view import WatchView
from calib.watch.watcher import Watcher
from sim.arm import load_arm


def screen(watcher: Watcher, width: int, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", str(width))
    console = Console(file=io.StringIO(), width=width)
    with console.capture() as text:
        console.print(WatchView("arm from log").screen(0.0, watcher.picture(), watcher.arm.joint_names))
    return text.get()


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_column_without_room_is_left_out_and_no_number_is_cut(
    width: int, at_work: Callable[[], Watcher], monkeypatch: pytest.MonkeyPatch
) -> None:
    watcher = at_work()
    text = screen(watcher, width, monkeypatch)
    for joint, f in zip(watcher.arm.joint_names, watcher.picture().friction, strict=True):
        (row,) = [line for line in text.splitlines() if line.startswith(joint)]
        assert f"{f.coulomb.value:.2f} ± {2 * f.coulomb.std:.2f}" in row
    assert "…" not in text
    assert ("°C" in text) == (width > 80)


def test_before_the_first_reading_nothing_is_shown_as_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    text = screen(Watcher(load_arm("ur10e"), 500.0), 80, monkeypatch)
    assert "nan" not in text
    assert "±" not in text
    assert "motion s" in text
    assert "°C" in text
