"""A cell with impossible postures, obstacles, effects or names is refused; the error names the entry and the rule."""

from pathlib import Path

import pytest

from drivers import open_driver
from sim.arm import load_arm
from sim.arm_folder import write_arm
from sim.cell import Cell, load_arm_of, load_cell
from sim.errors import ConfigError

ARM = load_arm("ur10e")


def opened(tmp_path: Path, lines: str) -> Cell:
    file = tmp_path / "cell.toml"
    file.write_text(f'schema = "cell/1"\nname = "cell"\narm = "ur10e"\ndriver = "mock"\n{lines}\n')
    cell = load_cell(file)
    open_driver(cell, ARM)
    return cell


@pytest.mark.parametrize("key", ["home", "rest"])
@pytest.mark.parametrize(
    ("angles", "message"),
    [
        ([0.0] * 5, "has 5 angles; ur10e has 6 joints: shoulder_pan_joint"),
        ([0.0, -80.0, 75.0, -80.0, -70.0, 17.0], "shoulder_lift_joint at -80 rad; its range is -6.283 to 6.283 rad"),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 6.284], "wrist_3_joint at 6.284 rad"),
    ],
)
def test_a_posture_that_the_arm_cannot_take(tmp_path: Path, key: str, angles: list[float], message: str) -> None:
    with pytest.raises(ConfigError, match=f"{key} has") as error:
        opened(tmp_path, f"{key} = {angles}")
    assert message in str(error.value)


def test_postures_at_the_limits(tmp_path: Path) -> None:
    table = opened(tmp_path, f"home = {ARM.q_min.tolist()}\nrest = {ARM.q_max.tolist()}").table
    assert (table.home, table.rest) == (ARM.q_min.tolist(), ARM.q_max.tolist())


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        ('kind = "plane"\nposition = [0, 0, -1]\nnormal = [0, 0, 0]', "no direction"),
        ('kind = "box"\nposition = [2, 0, 0]\nsize = [0.1, 0.0, 0.1]', "above 0"),
        ('kind = "box"\nposition = [2, 0, 0]\nsize = [0.1, -0.1, 0.1]', "above 0"),
    ],
)
def test_an_obstacle_without_extent(tmp_path: Path, obstacle: str, message: str) -> None:
    with pytest.raises(ConfigError, match=f"'thing'.*{message}"):
        opened(tmp_path, f'[[obstacles]]\nname = "thing"\n{obstacle}')


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        ('effect = "joint_sprong"\nparameters = {}', "there is no effect 'joint_sprong'"),
        ('effect = "viscous_friction"\nparameters = { viscous = 1.0 }', "a joint is needed"),
        ('effect = "base_tilt"\nparameters = { roll = 9.0, pitch = 0.0 }', "roll = 9.0 rad"),
    ],
)
def test_a_hidden_effect_that_cannot_be(tmp_path: Path, effect: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"cell\.toml: \[emulation\]: ") as error:
        opened(tmp_path, f"[[emulation.effects]]\n{effect}")
    assert message in str(error.value)


def test_what_a_cell_assumes(tmp_path: Path) -> None:
    opened(tmp_path, 'assume = ["watchdog-works"]')
    assert "pulling the cable" in load_cell(tmp_path / "cell.toml").assumed["watchdog-works"]
    with pytest.raises(ConfigError, match=r"'watchdog-work' is not a known assumption; did you mean 'watchdog-works'"):
        opened(tmp_path, 'assume = ["watchdog-work"]')


def test_a_misspelt_key_of_an_obstacle_is_named_with_the_keys_of_its_kind(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    text = (Path(__file__).parents[2] / "configs" / "cells" / "mock-ur10e.toml").read_text()
    file.write_text(text.replace("normal =", "normel ="))
    with pytest.raises(
        ConfigError, match=r"obstacles.0.plane.normel; did you mean 'normal'. known: kind, name, position, normal"
    ):
        load_cell(file)


def test_a_kind_of_obstacle_that_there_is_not(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"obstacles\.0\.kind = 'plain': unknown; did you mean 'plane'\? known: box, plane, mesh"
    ):
        opened(tmp_path, '[[obstacles]]\nkind = "plain"\nname = "table"')


def test_an_arm_may_lie_beside_the_cell_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_arm(tmp_path / "arms" / "own", ARM, name="own")
    (tmp_path / "cells").mkdir()
    monkeypatch.chdir(tmp_path)
    for arm in ("../arms/own", "arms/own"):
        file = tmp_path / "cells" / "cell.toml"
        file.write_text(f'schema = "cell/1"\nname = "cell"\narm = "{arm}"\ndriver = "mock"\n')
        assert load_arm_of(load_cell(file)).name == "own"


def test_a_cell_with_an_arm_that_there_is_not_names_its_file(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('schema = "cell/1"\nname = "cell"\narm = "servo7"\ndriver = "mock"\n')
    with pytest.raises(ConfigError, match=r"cell\.toml: arm: there is no arm 'servo7'; did you mean 'servo6'"):
        load_arm_of(load_cell(file))
