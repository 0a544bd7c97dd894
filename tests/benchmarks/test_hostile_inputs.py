"""Mutated inputs reach every command, and a fault of a command is counted."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from benchmarks import hostile_commands
from benchmarks.hostile_changes import changed, log_of, words_of
from benchmarks.hostile_inputs import CASES
from calib.main import COMMANDS

LEFT_OUT = {"init"}  # it would contact a mutated address


def test_every_command_has_mutants() -> None:
    reached = {name.split(",")[0].split()[0] for name in CASES}
    assert set(COMMANDS) - reached == LEFT_OUT


@pytest.mark.parametrize("seed", range(20))
def test_a_changed_recording_can_be_written(seed: int) -> None:
    log = changed(log_of("ur10e_ur_rtde.csv"), random.Random(seed))
    assert np.all(np.diff(log.t) >= 0)
    assert len(log) == len(log.q) == len(log.tau) >= 1


def test_only_marked_words_change(tmp_path: Path) -> None:
    mutant = words_of(None, "plan", "@ur10e", "--period", "#3", "--out", "OUT")(tmp_path)
    seen = [mutant(random.Random(k)) for k in range(30)]
    assert {tuple(words[k] for k in (0, 2, 4, 5)) for words in seen} == {("plan", "--period", "--out", str(tmp_path / "out"))}
    assert len({tuple(words) for words in seen}) > 15


def test_a_fault_is_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    codes = iter([2, 70, 0])

    def program(words: list[str]) -> int:
        code = next(codes)
        print("RuntimeWarning: divide by zero" if code == 0 else "no")
        return code

    monkeypatch.setattr(hostile_commands, "program", program)
    found = hostile_commands.attack("effects, words", 0, 3)
    assert len(found["faults"]) == 2
    assert found["refused"] == 1
