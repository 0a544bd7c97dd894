"""Bodies of arm and cell: a doubtful position or size is refused; distances are computed for all others."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from safety.collision import Clearance
from safety.reach import spine
from safety.shapes import hull
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError
from sim.tree import Shape
from tests.safety.conftest import CELL, HOME


def cell_with(tmp_path: Path, obstacle: str) -> Cell:
    file = tmp_path / "cell.toml"
    file.write_text(CELL + obstacle)
    return load_cell(file)


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [
        ('[[obstacles]]\nkind = "box"\nname = "x"\nposition = [2, 0, 0]\nsize = [0.1, 0.0, 0.1]\n', "above 0"),
        ('[[obstacles]]\nkind = "box"\nname = "x"\nposition = [2, 0, 0]\nsize = [0.1, -0.1, 0.1]\n', "above 0"),
        ('[[obstacles]]\nkind = "box"\nname = "x"\nposition = [2, 0, 0]\nsize = [100, 100, 100]\n', "millimetres"),
        ('[[obstacles]]\nkind = "plane"\nname = "x"\nposition = [0, 0, -1]\nnormal = [0, 0, 0]\n', "no direction"),
        ('[[obstacles]]\nkind = "mesh"\nname = "x"\nfile = "missing.stl"\n', "cannot be read"),
        ('[[obstacles]]\nkind = "mesh"\nname = "x"\nfile = "../../x.stl"\n', "leaves"),
        ('[[obstacles]]\nkind = "mesh"\nname = "x"\nfile = "bad.obj"\n', "not a mesh"),
        ('[[obstacles]]\nkind = "mesh"\nname = "x"\nfile = "huge.obj"\n', "millimetres"),
    ],
)
def test_obstacles_that_could_lie_are_refused(arm: Arm, tmp_path: Path, obstacle: str, message: str) -> None:
    (tmp_path / "bad.obj").write_text("v 0 0 nonsense\n")
    (tmp_path / "huge.obj").write_text(cube(500.0))
    with pytest.raises(ConfigError, match=message):
        Clearance(arm, cell_with(tmp_path, obstacle))


def cube(edge: float) -> str:
    corners = [(x, y, z) for x in (0, edge) for y in (0, edge) for z in (0, edge)]
    faces = [(1, 3, 4), (1, 4, 2), (5, 6, 8), (5, 8, 7), (1, 2, 6), (1, 6, 5), (3, 7, 8), (3, 8, 4), (1, 5, 7), (1, 7, 3)]
    faces += [(2, 4, 8), (2, 8, 6)]
    return "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces)


def test_a_mesh_stands_where_its_box_would(arm: Arm, tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(cube(0.2))
    both = cell_with(
        tmp_path,
        '[[obstacles]]\nkind = "mesh"\nname = "m"\nfile = "cube.obj"\nposition = [0.7, 0.3, 0.2]\nrpy = [0.1, 0.2, 0.3]\n'
        '[[obstacles]]\nkind = "box"\nname = "b"\nposition = [0.0, 0.0, 9.0]\nsize = [0.2, 0.2, 0.2]\n',
    )
    clearance = Clearance(arm, both)
    found = dict(zip(clearance.pairs, clearance.distances(HOME), strict=True))
    corner = np.array([0.7, 0.3, 0.2])

    middle = corner + pin.rpy.rpyToMatrix(0.1, 0.2, 0.3) @ np.full(3, 0.1)
    at = ", ".join(map(repr, middle.tolist()))
    box = cell_with(
        tmp_path, f'[[obstacles]]\nkind = "box"\nname = "m"\nposition = [{at}]\nrpy = [0.1, 0.2, 0.3]\nsize = [0.2, 0.2, 0.2]\n'
    )
    for pair, distance in zip(Clearance(arm, box).pairs, Clearance(arm, box).distances(HOME), strict=True):
        assert distance == pytest.approx(found[pair], abs=1e-5)


def with_shape(arm: Arm, **changes: object) -> Arm:
    shapes = list(arm.tree.shapes)
    shapes[1] = replace(shapes[1], **changes)  # type: ignore[arg-type]
    return replace(arm, tree=replace(arm.tree, shapes=tuple(shapes)))


@pytest.mark.parametrize(
    "changes",
    [
        {"size": (-0.1, 0.2, 0.0)},
        {"size": (0.0, 0.2, 0.0)},
        {"size": (np.nan, 0.2, 0.0)},
        {"size": (np.inf, 0.2, 0.0)},
        {"size": (80.0, 0.2, 0.0)},
        {"position": np.array([0, 0, np.nan])},
        {"rotation": np.full((3, 3), np.nan)},
        {"kind": "mesh", "vertices": np.full((8, 3), np.nan)},
        {"kind": "mesh", "vertices": np.zeros((8, 3))},
        {"kind": "mesh", "vertices": np.eye(3)},
        {"kind": "mesh", "vertices": np.random.default_rng(0).normal(size=(20, 3)) * 1000},
    ],
)
def test_shapes_that_could_lie_are_refused(arm: Arm, cell: Cell, changes: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match="shape"):
        Clearance(with_shape(arm, **changes), cell)


def test_points_in_a_plane_that_is_not_level_are_refused() -> None:
    x = np.random.default_rng(0).normal(size=(10, 2))
    with pytest.raises(ConfigError, match="one plane"):
        hull(np.column_stack((x, x.sum(axis=1))), "mesh")


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "box", "mesh"])
def test_every_kind_of_shape_has_its_distance(arm: Arm, cell: Cell, kind: str) -> None:
    vertices = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    around = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 24)])
    surface = {
        "sphere": 0.1 * np.vstack([np.eye(3), -np.eye(3)]),
        "cylinder": 0.1 * np.array([[x, y, z] for x, y in around for z in (-1, 1)]),
    }.get(kind, vertices)
    size = {"sphere": (0.1, 0, 0), "cylinder": (0.1, 0.1, 0), "box": (0.1, 0.1, 0.1), "mesh": (0.1, 0.1, 0.1)}[kind]
    changed = with_shape(arm, kind=kind, size=size, vertices=vertices)
    shape: Shape = changed.tree.shapes[1]
    points, radius = spine(shape)
    away = surface @ shape.rotation.T + shape.position - points[:, None]
    np.testing.assert_array_less(np.linalg.norm(away, axis=2).min(axis=0), radius + 1e-9)
    clearance = Clearance(changed, cell)
    assert np.all(np.isfinite(clearance.distances(HOME)))


def changed(arm_folder: Path, tmp_path: Path, old: str, new: str) -> Path:
    folder = tmp_path / "test6"
    shutil.copytree(arm_folder, folder)
    text = (folder / "model.xml").read_text()
    assert old in text
    (folder / "model.xml").write_text(text.replace(old, new))
    return folder


def test_an_ellipsoid_is_taken_as_the_box_around_it(arm_folder: Path, cell: Cell, tmp_path: Path) -> None:
    ball = 'name="w3" type="sphere" size="0.045"'
    egg = changed(arm_folder, tmp_path, ball, 'name="w3" type="ellipsoid" size="0.03 0.04 0.05"')
    shape = next(s for s in load_arm(egg).tree.shapes if s.name == "w3")
    assert (shape.kind, shape.size) == ("box", (0.03, 0.04, 0.05))
    assert ("w3", "table") in Clearance(load_arm(egg), cell).pairs


def test_a_body_of_which_nothing_can_be_proved_is_refused(arm_folder: Path, tmp_path: Path) -> None:
    asset = '<asset><mesh name="m" builtin="sphere" params="1"/></asset><worldbody>'
    other = changed(arm_folder, tmp_path, "<worldbody>", asset)
    text = (other / "model.xml").read_text()
    (other / "model.xml").write_text(text.replace('name="w3" type="sphere" size="0.045"', 'name="w3" type="sdf" mesh="m"'))
    with pytest.raises(ConfigError, match="mjGEOM_SDF"):
        load_arm(other)
