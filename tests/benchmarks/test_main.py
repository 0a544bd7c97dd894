"""`make bench`: the default options fit the signature of every topic, and a topic that fails does not stop the others."""

from __future__ import annotations

import inspect
import json
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks import ONE_THREAD, results
from benchmarks.__main__ import SLOW, TOPICS, main


@pytest.mark.parametrize("topic", [*TOPICS, *SLOW])
def test_a_topic_takes_what_it_is_given(topic: str) -> None:
    run = import_module(f"benchmarks.{topic}").run
    inspect.signature(run).bind(**TOPICS.get(topic, {}))


def test_a_topic_needs_nothing_to_run_in_full() -> None:
    for topic in (*TOPICS, *SLOW):
        inspect.signature(import_module(f"benchmarks.{topic}").run).bind()


def test_a_topic_that_fails_is_reported_and_takes_no_other_with_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken() -> list[dict[str, Any]]:
        raise RuntimeError("the emulator did not start")

    whole = SimpleNamespace(
        MEASURES=("benchmarks/kept.py",),
        run=lambda: [{"what": "a figure", "value": "1.5", "unit": "ms", "bar": "<= 2", "note": ""}],
    )
    monkeypatch.setattr(results, "FOLDER", tmp_path / "results")
    for key, value in ONE_THREAD.items():
        monkeypatch.setenv(key, value)  # so that what main sets is undone after the test
    for name, module in (("first", SimpleNamespace(run=broken)), ("second", whole)):
        monkeypatch.setitem(sys.modules, f"benchmarks.{name}", module)
        monkeypatch.setitem(TOPICS, name, {})
    with pytest.raises(SystemExit, match="first"):
        main(["first", "second", "--json", str(tmp_path / "rows.json")])
    printed = capsys.readouterr().out
    assert "the emulator did not start" in printed
    assert "a figure" in printed
    assert [r["topic"] for r in json.loads((tmp_path / "rows.json").read_text())] == ["first", "second"]
