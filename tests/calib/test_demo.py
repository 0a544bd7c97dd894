"""The demo hides something that can be found, tells the tool nothing of it, and ends with what was hidden and the report's path."""

import json
from pathlib import Path

import pytest

from calib import demo
from calib.main import main
from sim.arm import load_arm
from sim.cell import load_cell
from sim.effects import effect_named

ARM, CELL = load_arm("ur10e"), load_cell("mock-ur10e")


def test_every_effect_that_may_be_hidden_is_drawn_and_is_in_the_catalogue() -> None:
    drawn = {demo.hide(ARM, seed).effect for seed in range(80)}
    assert drawn == set(demo.HIDDEN)
    for name in demo.HIDDEN:
        assert (effect_named(name).scope == "arm") is (name in demo.WHOLE_ARM)


def test_a_seed_draws_the_same_again() -> None:
    assert demo.hide(ARM, 5) == demo.hide(ARM, 5)
    assert len({str(demo.hide(ARM, seed)) for seed in range(30)}) > 20


def test_the_effect_stands_in_the_emulation_of_the_cell_and_nowhere_else(tmp_path: Path) -> None:
    hidden = demo.hide(ARM, 7)
    demo.write_cell(tmp_path / "demo-cell.toml", CELL, hidden, 7)
    cell = load_cell(tmp_path / "demo-cell.toml")
    assert [(e.effect, e.joint, e.parameters) for e in cell.table.emulation.effects] == [
        (hidden.effect, hidden.joint, hidden.parameters)
    ]
    assert cell.table.model_copy(update={"name": CELL.name, "emulation": CELL.table.emulation}) == CELL.table
    for step in demo.story("ur10e", tmp_path / "demo-cell.toml", tmp_path):
        assert hidden.effect not in " ".join(step.arguments)


@pytest.mark.slow
def test_the_whole_story(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--seed", "11", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["hidden"]["effect"] == "coulomb_friction"
    assert Path(told["report"]).is_file()
