"""A tool is a body: its position and size, its pairs, its fastest point, and the clearance that it needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety.clear import clear
from safety.collision import Clearance
from safety.reach import fastest_point, spine
from safety.shapes import equipped
from sim.arm import Arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError, SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import CELL, HOME
from tests.safety.test_shapes import cube

ROD = '[[tool]]\nkind = "capsule"\nname = "rod"\nends = [[0.0, 0.05, 0.0], [0.0, 0.35, 0.0]]\nradius = 0.02\n'
BLOCK = '[[tool]]\nkind = "box"\nname = "block"\nposition = [0.0, 0.2, 0.0]\nrpy = [0.0, 0.0, 0.3]\nsize = [0.1, 0.2, 0.3]\n'
MESH = '[[tool]]\nkind = "mesh"\nname = "part"\nfile = "part.obj"\nposition = [0.0, 0.1, 0.0]\n'


def cell_with(folder: Path, text: str) -> Cell:
    (folder / "part.obj").write_text(cube(0.1))
    (folder / "cell.toml").write_text(CELL + text)
    return load_cell(folder / "cell.toml")


def test_a_tool_is_a_body_on_the_last_link(arm: Arm, tmp_path: Path) -> None:
    held = equipped(arm, cell_with(tmp_path, ROD + BLOCK + MESH))
    rod, block, part = held.tree.shapes[-3:]
    assert {s.link for s in (rod, block, part)} == {arm.n - 1}
    points, radius = spine(rod)
    np.testing.assert_allclose(sorted(points[:, 1]), [0.05, 0.35], atol=1e-12)
    np.testing.assert_allclose(points[:, [0, 2]], 0, atol=1e-12)
    assert radius == 0.02
    assert block.size == (0.05, 0.1, 0.15)
    np.testing.assert_allclose(np.ptp(spine(part)[0], axis=0), 0.1, atol=1e-6)
    assert equipped(held, cell_with(tmp_path, ROD)) is held
    assert equipped(arm, cell_with(tmp_path, "")) is arm


def test_a_shape_of_the_arm_is_not_taken_for_the_tool_of_the_cell(arm: Arm, tmp_path: Path) -> None:
    """The model of an arm may have a `tool changer`; the cell's tool is checked beside it."""
    changer = replace(arm.tree.shapes[-1], name="tool changer")
    other = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, changer)))
    clearance = Clearance(other, cell_with(tmp_path, ROD))
    seen = set(clearance.pairs) | set(clearance.always_apart) | set(clearance.excluded)
    assert any("tool rod" in pair for pair in seen)
    namesake = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, replace(changer, name="tool rod"))))
    with pytest.raises(ConfigError, match="has a shape named tool rod too; rename"):
        Clearance(namesake, cell_with(tmp_path, ROD))


def test_a_motion_that_is_free_without_its_tool_is_refused_with_it(arm: Arm, tmp_path: Path) -> None:
    t = np.linspace(0, 2, 201)
    still = Trajectory(t, np.tile(HOME, (201, 1)), np.zeros((201, 6)), np.zeros((201, 6)))
    plain = cell_with(tmp_path, "")
    free = clear(still, arm, plain).verdict
    assert free.near["the cell"].distance > 0.1
    wide = ROD.replace("radius = 0.02", "radius = 0.7")
    with pytest.raises(SafetyStop, match="tool rod"):
        clear(still, arm, cell_with(tmp_path, wide))


def test_a_tool_is_looked_at_against_every_link_but_its_own(arm: Arm, tmp_path: Path) -> None:
    clearance = Clearance(arm, cell_with(tmp_path, ROD))
    pairs = set(clearance.pairs) | set(clearance.always_apart) | set(clearance.excluded)
    with_rod = {a if b == "tool rod" else b for a, b in pairs if "tool rod" in (a, b)}
    assert with_rod == {"shoulder", "upper", "fore", "w1", "w2", "table", "post"}


def test_the_tip_of_a_tool_is_the_fastest_point(arm: Arm, tmp_path: Path) -> None:
    held = equipped(arm, cell_with(tmp_path, ROD))
    dq = np.zeros((2, 6))
    dq[:, 4] = 1.0
    turning = Trajectory(np.array([0.0, 0.01]), np.vstack((HOME, HOME + 0.01 * dq[0])), dq, np.zeros((2, 6)))
    assert fastest_point(turning, held) == pytest.approx(0.1 + 0.35 + 0.02, abs=1e-3)
    assert fastest_point(turning, arm) < 0.2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ROD.replace("radius = 0.02", "radius = 0.0"), "radius"),
        (BLOCK.replace("0.3]\n", "-0.3]\n"), "above 0"),
        (BLOCK.replace("size = [0.1, 0.2, 0.3]", "size = [100.0, 200.0, 300.0]"), "millimetres"),
        (MESH.replace("part.obj", "missing.obj"), "cannot be read"),
        (MESH.replace("part.obj", "../part.obj"), "leaves"),
    ],
)
def test_a_tool_that_is_no_body_is_refused(arm: Arm, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "inside").mkdir()
    with pytest.raises(ConfigError, match=message):
        Clearance(arm, cell_with(tmp_path / "inside", text))


def test_what_was_read_with_the_cell_is_what_is_looked_at(arm: Arm, tmp_path: Path) -> None:
    cell = cell_with(tmp_path, MESH)
    (tmp_path / "part.obj").write_text(cube(0.9))
    np.testing.assert_allclose(np.ptp(equipped(arm, cell).tree.shapes[-1].vertices, axis=0), 0.1, atol=1e-6)
    with pytest.raises(ConfigError, match="was not read"):
        equipped(arm, replace(cell, files={}))
