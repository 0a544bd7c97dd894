"""Clearance is proved against an independent look at the same bodies, and geometry that could lie is refused."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from drivers.driver import DeviceStop
from safety.collision import Clearance
from safety.device_stops import DeviceStops
from safety.reach import joint_reach, spine
from safety.shapes import hull
from safety.sheets import PathSheet
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError, SafetyStop
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from sim.tree import Shape
from tests.safety.conftest import CELL, HOME, sine

LEAST = 1e-4


def cell_with(tmp_path: Path, obstacle: str) -> Cell:
    file = tmp_path / "cell.toml"
    file.write_text(CELL + obstacle)
    return load_cell(file)


def test_pairs_leave_out_only_links_that_share_a_joint(arm: Arm, cell: Cell) -> None:
    pairs = Clearance(arm, cell).pairs
    names = [s.name for s in arm.tree.shapes]
    expected = {(a, b) for i, a in enumerate(names) for k, b in enumerate(names) if k - i >= 2}
    expected |= {(a, o) for a in names for o in ("table", "post")}
    clearance = Clearance(arm, cell)
    excluded = set(clearance.always_apart) | set(clearance.excluded)
    assert set(pairs) == expected - excluded
    assert ("shoulder", "table") in excluded


def test_a_pair_is_left_out_only_where_it_keeps_its_margin_in_every_posture(arm: Arm, cell: Cell) -> None:
    """Looked at anew, with the same bodies, at postures from everywhere."""
    every = Clearance(arm, cell)
    clearance = Clearance(arm, cell)
    clearance._geometry.removeAllCollisionPairs()
    ids = {clearance._geometry.geometryObjects[k].name: k for k in range(clearance._geometry.ngeoms)}
    for pair in every.always_apart:
        clearance._geometry.addCollisionPair(pin.CollisionPair(*(ids[name] for name in pair)))
    count = len(every.always_apart)
    clearance._set(list(every.always_apart), np.zeros((count, arm.n)), np.zeros(count))
    rng = np.random.default_rng(2)
    found = np.array([clearance.distances(q) for q in rng.uniform(arm.q_min, arm.q_max, (300, arm.n))])
    least = np.array([float(re.findall(r"[0-9.]+", why)[0]) for why in every.always_apart.values()])
    assert np.all(1e3 * found.min(axis=0) >= least - 0.1)
    assert np.all(least > 0)


def test_reach_bounds_how_far_any_point_moves(arm: Arm, cell: Cell) -> None:
    """No distance changes by more than reach times joint travel, at random postures; the property that the proof rests on."""
    rng = np.random.default_rng(0)
    clearance = Clearance(arm, cell)
    for _ in range(300):
        q = rng.uniform(-3, 3, arm.n)
        step = rng.uniform(-0.3, 0.3, arm.n)
        change = np.abs(clearance.distances(q + step) - clearance.distances(q))
        apart = (clearance.distances(q) > 0) & (clearance.distances(q + step) > 0)
        assert np.all(change[apart] <= (clearance.reach @ np.abs(step) + 1e-5)[apart])


def test_reach_bounds_the_jacobian(arm: Arm) -> None:
    rng = np.random.default_rng(1)
    body = RigidBody(arm)
    for shape in arm.tree.shapes:
        points, radius = spine(shape)
        reach = joint_reach(arm, shape)
        for point in points:
            linear, _ = body.jacobian(rng.uniform(-3, 3, (50, arm.n)), shape.link, point)
            assert np.all(np.linalg.norm(linear, axis=1) + radius * (reach > 0) <= reach + 1e-9)


def towards_table(depth: float) -> Trajectory:
    """Lowers the outstretched arm by rotating the shoulder to `depth` rad and back."""
    motion = sine(amplitude=0.0, cycles=1)
    t, x = motion.t, np.sin(np.pi * motion.t / motion.t[-1]) ** 2
    w = np.pi / motion.t[-1]
    q, dq, ddq = (np.zeros((len(t), 6)) for _ in range(3))
    q[:, 1], dq[:, 1], ddq[:, 1] = depth * x, depth * w * np.sin(2 * w * t), 2 * depth * w**2 * np.cos(2 * w * t)
    return Trajectory(t, q, dq, ddq)


def test_certified_and_densely_sampled_agree(arm: Arm, cell: Cell) -> None:
    clearance = Clearance(arm, cell)
    for depth in np.linspace(-0.2, 0.3, 11):
        motion = towards_table(float(depth))
        least = min(float(np.min(clearance.distances(q) - clearance.margin)) for q in motion.q[::2])
        if least > 1e-3:
            clearance.certify(PathSheet(motion, arm), "the motion", LEAST, 0.1)
        elif least < 0:
            with pytest.raises(SafetyStop, match="table"):
                clearance.certify(PathSheet(motion, arm), "the motion", LEAST, 0.1)


def test_the_room_beside_a_motion_is_really_there(arm: Arm, cell: Cell) -> None:
    """Every joint beside the path by the proved room, to either side: margins are kept; and where there is little, little is promised."""
    clearance, rng = Clearance(arm, cell), np.random.default_rng(0)
    motion = towards_table(0.11)
    room = clearance.certify(PathSheet(motion, arm), "the motion", LEAST, 0.1)
    assert np.all(room >= LEAST)
    assert room.min() < 0.02 < room.max()
    for k in range(0, len(motion) - 1, 3):
        for _ in range(20):
            beside = motion.q[k] + room[k] * rng.choice((-1, 1), arm.n)
            assert np.all(clearance.distances(beside) >= clearance.margin - 1e-6)


def test_the_witness_is_where_the_bodies_are_nearest(arm: Arm, cell: Cell) -> None:
    motion = towards_table(0.1)
    both = Clearance(arm, cell).nearest_on(motion.t, motion.q)
    assert set(both) == {"the cell", "itself"}
    near = both["the cell"]
    assert near.pair[1] == "table"
    assert near.t == pytest.approx(2.0, abs=0.02)
    assert "table" in str(near)
    assert "table" not in both["itself"].pair


def test_a_collision_shorter_than_the_sampling_step_is_found(arm: Arm, cell: Cell) -> None:
    """Two samples, both free; the quintic between them dips into the table."""
    q = np.zeros((2, 6))
    q[:, 1] = -0.25
    dq = np.zeros((2, 6))
    dq[:, 1] = [1.9, -1.9]
    motion = Trajectory(np.array([0.0, 1.0]), q, dq, np.zeros((2, 6)))
    clearance = Clearance(arm, cell)
    assert np.all(clearance.distances(q[0]) > clearance.margin)
    with pytest.raises(SafetyStop, match="table"):
        clearance.certify(PathSheet(motion, arm), "the motion", LEAST, 0.1)


@pytest.mark.parametrize(("begin", "free"), [(-0.2, True), (0.0, False)])
def test_long_stops_from_two_samples_are_cut_along_the_stop(arm: Arm, cell: Cell, begin: float, free: bool) -> None:
    """From 1 rad/s at 2 rad/s^2 the outstretched arm sinks by 0.25 rad; the table is met 0.14 rad below the horizontal."""
    q, dq = np.zeros((2, 6)), np.zeros((2, 6))
    q[:, 1], dq[:, 1] = [begin, begin + 0.002], 1.0
    stops = DeviceStops(Trajectory(np.array([0.0, 0.002]), q, dq, np.zeros((2, 6))), arm, DeviceStop(0.0, 2.0), 0.0)
    clearance = Clearance(arm, cell)
    if free:
        clearance.certify(stops, "the device's own stop", LEAST, 0.1)
    else:
        with pytest.raises(SafetyStop, match=r"the device's own stop: .*table"):
            clearance.certify(stops, "the device's own stop", LEAST, 0.1)


def test_one_distance_that_is_not_a_number_is_refused(arm: Arm, cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    clearance = Clearance(arm, cell)
    assert np.all(clearance.distances(HOME) > 0)
    real = pin.computeDistance
    nothing = SimpleNamespace(min_distance=np.nan)
    monkeypatch.setattr(pin, "computeDistance", lambda model, data, pair: nothing if pair == 3 else real(model, data, pair))
    with pytest.raises(SafetyStop, match="a distance is not a number"):
        clearance.distances(HOME)


@pytest.mark.parametrize("what", ["distance", "reach", "margin"])
def test_a_box_of_which_a_bound_is_not_a_number_is_refused(
    arm: Arm, cell: Cell, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """Also where one pair stands still, and where nobody looked at the distances before."""
    clearance = Clearance(arm, cell)
    clearance.certify(PathSheet(sine(), arm), "the motion", LEAST, 0.1)
    if what == "distance":
        real = Clearance.distances
        monkeypatch.setattr(
            Clearance, "distances", lambda self, q, pairs=None: np.where(np.isin(pairs, [3]), np.nan, real(self, q, pairs))
        )
    elif what == "margin":
        clearance.margin[3] = np.nan
    else:
        reach = clearance.reach.copy()
        reach[3, 1] = np.nan
        clearance._set(clearance.pairs, reach, clearance.margin)
    with pytest.raises(SafetyStop, match="the motion"):
        clearance.certify(PathSheet(sine(), arm), "the motion", LEAST, 0.1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_posture_that_is_not_finite_is_never_free(arm: Arm, cell: Cell, bad: float) -> None:
    clearance = Clearance(arm, cell)
    for j in range(arm.n):
        q = HOME.copy()
        q[j] = bad
        with pytest.raises(SafetyStop, match="finite"):
            clearance.distances(q)
    sheet = PathSheet(sine(), arm)
    sheet.boxes.hi[7, 0, 0, 2] = bad
    with pytest.raises(SafetyStop, match="finite"):
        clearance.certify(sheet, "the motion", LEAST, 0.1)
    with pytest.raises(SafetyStop, match="wrong length"):
        clearance.distances(HOME[:5])


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
    import pinocchio as pin

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
    size = {"sphere": (0.1, 0, 0), "cylinder": (0.1, 0.1, 0), "box": (0.1, 0.1, 0.1), "mesh": (0.1, 0.1, 0.1)}[kind]
    changed = with_shape(arm, kind=kind, size=size, vertices=vertices)
    shape: Shape = changed.tree.shapes[1]
    points, radius = spine(shape)
    assert np.all(np.linalg.norm(vertices - 0, axis=1) <= np.linalg.norm(points - shape.position, axis=1).max() + radius + 0.1)
    clearance = Clearance(changed, cell)
    assert np.all(np.isfinite(clearance.distances(HOME)))


def test_an_arm_without_shapes_is_refused(arm: Arm, cell: Cell) -> None:
    with pytest.raises(ConfigError, match="no clearance can be verified"):
        Clearance(replace(arm, tree=replace(arm.tree, shapes=())), cell)


def test_an_arm_with_one_link_and_nothing_around_it_has_no_pair(arm_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "one"
    shutil.copytree(arm_folder, folder)
    text = (folder / "model.xml").read_text()
    start, end = text.index('   <body name="upper"'), text.index("</body></body></body></body></body></body>")
    (folder / "model.xml").write_text(text[:start] + "</body>" + text[end + len("</body>" * 6) :])
    toml = (folder / "arm.toml").read_text().replace('["j1", "j2", "j3", "j4", "j5", "j6"]', '["j1"]')
    toml = "\n".join(line.split(",")[0] + "]" if line.count(",") == 5 else line for line in toml.split("\n"))
    (folder / "arm.toml").write_text(toml.split("[[effects]]")[0])
    one = load_arm(folder)
    bare = tmp_path / "bare.toml"
    bare.write_text('schema = "cell/1"\nname = "bare"\narm = "one"\ndriver = "mock"\n')
    clearance = Clearance(one, load_cell(bare))
    motion = sine(1)
    clearance.certify(PathSheet(motion, one), "the motion", LEAST, 0.1)
    assert clearance.nearest_on(motion.t, motion.q) == {}


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
