"""The demo hides an effect that can be found, keeps it from the commands, and ends with the effect and the report."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib import demo
from calib.main import main
from drivers import open_driver
from drivers.preflight import GRAVITY_TOLERANCE, preflight
from sim.arm import ArmEffect, load_arm
from sim.cell import load_cell
from sim.effects import effect_named

ARM, CELL = load_arm("ur10e"), load_cell("mock-ur10e")
HOME = np.array(CELL.table.home)


def test_every_effect_that_may_be_hidden_is_drawn_and_is_in_the_catalogue() -> None:
    drawn = {demo.hide(ARM, HOME, seed).effect for seed in range(80)}
    assert drawn == set(demo.HIDDEN)
    for name in demo.HIDDEN:
        assert (effect_named(name).scope == "arm") is (name in demo.WHOLE_ARM)


def test_a_seed_draws_the_same_again() -> None:
    assert demo.hide(ARM, HOME, 5) == demo.hide(ARM, HOME, 5)
    assert len({str(demo.hide(ARM, HOME, seed)) for seed in range(30)}) > 20


def test_nothing_is_hidden_that_the_check_would_see_before_the_arm_moves(tmp_path: Path) -> None:
    for seed in range(200):
        seen = np.abs(demo.torque_at_rest(ARM, HOME, demo.hide(ARM, HOME, seed)))
        assert np.all(seen <= 0.8 * GRAVITY_TOLERANCE * ARM.tau_max), seed


@pytest.mark.parametrize("seed", [7, 88, 9])
def test_the_story_passes_its_first_step(seed: int, tmp_path: Path) -> None:
    hidden = demo.hide(ARM, HOME, seed)
    demo.write_cell(tmp_path / "demo-cell.toml", CELL, hidden, seed)
    with open_driver(load_cell(tmp_path / "demo-cell.toml"), ARM) as driver:
        checks = {check.name: check for check in preflight(driver, CELL, 0.1)}
    assert checks["torque at rest"].ok is True, (hidden, checks["torque at rest"].detail)


def test_the_effect_stands_in_the_emulation_of_the_cell_and_nowhere_else(tmp_path: Path) -> None:
    hidden = demo.hide(ARM, HOME, 7)
    demo.write_cell(tmp_path / "demo-cell.toml", CELL, hidden, 7)
    cell = load_cell(tmp_path / "demo-cell.toml")
    assert [(e.effect, e.joint, e.parameters) for e in cell.table.emulation.effects] == [
        (hidden.effect, hidden.joint, hidden.parameters)
    ]
    assert cell.table.model_copy(update={"name": CELL.name, "emulation": CELL.table.emulation, "options": {}}) == CELL.table
    for step in demo.story("ur10e", tmp_path / "demo-cell.toml", tmp_path):
        assert hidden.effect not in " ".join(step.arguments)


def unit(effect: str, parameter: str) -> str:
    return next(p.unit for p in effect_named(effect).parameters if p.name == parameter)


def diagnosis(*effects: tuple[str, str | None, dict[str, float]]) -> dict[str, Any]:
    return {
        "effects": [
            {"effect": e, "joint": j, "parameters": {k: {"value": v, "std": 0.1, "unit": unit(e, k)} for k, v in p.items()}}
            for e, j, p in effects
        ]
    }


def test_what_was_hidden_is_shown_beside_what_was_found() -> None:
    hidden = ArmEffect("coulomb_friction", "elbow_joint", {"coulomb": 8.0})
    right = demo.reveal(hidden, diagnosis(("coulomb_friction", "elbow_joint", {"coulomb": 8.1})))
    assert right.right
    assert right.rows == [["coulomb_friction", "elbow_joint", "coulomb", "8 N m", "8.10 ± 0.10 N m"]]
    assert right.sentence == "the hidden effect was found, and nothing else"


def test_another_joint_is_another_effect() -> None:
    hidden = ArmEffect("coulomb_friction", "elbow_joint", {"coulomb": 8.0})
    wrong = demo.reveal(hidden, diagnosis(("coulomb_friction", "wrist_1_joint", {"coulomb": 8.1})))
    assert not wrong.right
    assert wrong.rows[0][4] is None
    assert "was not found" in wrong.sentence
    wrong_answer = diagnosis(("asymmetric_friction", "elbow_joint", {"half_difference": 5.0}))
    wrong_answer["effects"][0]["indistinguishable_from"] = [{"effect": hidden.effect, "joint": hidden.joint}]
    undecided = demo.reveal(hidden, wrong_answer)
    assert not undecided.right
    assert "cannot distinguish the hidden effect" in undecided.sentence
    assert not demo.reveal(hidden, diagnosis()).right


def test_what_was_named_too_much_is_admitted() -> None:
    hidden = ArmEffect("payload", None, {"mass": 2.0})
    both = demo.reveal(hidden, diagnosis(("payload", None, {"mass": 2.0}), ("backlash", "elbow_joint", {"half_gap": 0.001})))
    assert not both.right
    assert both.rows[1] == ["backlash", "elbow_joint", "half_gap", None, "0.00 ± 0.10 rad"]
    assert both.sentence == "the hidden effect was found, and also 1 more effect that was not hidden"


@pytest.mark.slow
def test_the_whole_story(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--seed", "11"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "And this was hidden: " in "".join(lines)
    assert sum("$ calib " in line for line in lines) == len(demo.story("ur10e", Path("c"), Path("f")))
    assert lines[-1].endswith("diagnosis/report.html")
    assert Path(lines[-1]).is_file()
