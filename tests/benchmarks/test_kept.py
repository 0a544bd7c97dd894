"""Work in slices: stored findings are not computed again, and findings of other code or inputs are not used."""

from __future__ import annotations

from pathlib import Path

from benchmarks.kept import Kept


def test_a_second_run_knows_what_the_first_one_found(tmp_path: Path) -> None:
    file = tmp_path / "build" / "found.jsonl"
    first = Kept(file, "a")
    first.keep("run 0", {"angle": 0.5})
    first.keep("run 0", {"angle": 0.7})
    assert Kept(file, "a").found == {"run 0": {"angle": 0.5}}
    assert Kept(file, "b").found == {}


def test_a_line_that_was_cut_off_is_no_finding(tmp_path: Path) -> None:
    file = tmp_path / "found.jsonl"
    kept = Kept(file, "a")
    kept.keep("run 0", True)
    file.write_text(file.read_text() + '{"of": "a", "what": "run 1", "fou')
    again = Kept(file, "a")
    assert again.found == {"run 0": True}
    again.keep("run 1", True)
    assert Kept(file, "a").found == {"run 0": True, "run 1": True}
