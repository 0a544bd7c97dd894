"""Distances, and the reach that bounds their change, are checked at random postures; misleading geometry is refused."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from safety.certify import certify
from safety.collision import Clearance
from safety.reach import joint_reach, spine
from safety.sheets import PathSheet
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError, SafetyStop
from sim.rigid_body import RigidBody
from tests.safety.conftest import HOME, sine
from tests.safety.test_certify import LEAST, towards_table


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
    """Recomputes the distances of these pairs, with the same bodies, at random postures over the whole range."""
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
    """At random postures, no distance changes by more than reach times joint travel; the certificate relies on this."""
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


def test_the_witness_is_where_the_bodies_are_nearest(arm: Arm, cell: Cell) -> None:
    motion = towards_table(0.1)
    both = Clearance(arm, cell).nearest_on(motion.t, motion.q)
    assert set(both) == {"the cell", "itself"}
    near = both["the cell"]
    assert near.pair[1] == "table"
    assert near.t == pytest.approx(2.0, abs=0.02)
    assert "table" in str(near)
    assert "table" not in both["itself"].pair


def test_the_witness_is_the_least_distance_whatever_the_margins(arm: Arm, cell: Cell) -> None:
    motion, clearance = towards_table(0.1), Clearance(arm, cell)
    every = np.array([clearance.distances(q) for q in motion.q])
    table = ~clearance.of_self
    far = int(np.argmax(np.where(table, every.min(axis=0), -np.inf)))
    clearance.margin[far] = 1.0
    near = clearance.nearest_on(motion.t, motion.q)["the cell"]
    assert near.pair != clearance.pairs[far]
    assert near.distance == pytest.approx(every[:, table].min(), abs=1e-5)


def test_the_witness_is_found_between_the_looks(arm: Arm, cell: Cell) -> None:
    motion, clearance = towards_table(0.1), Clearance(arm, cell)
    samples = 40_001  # a hundred samples per distance check; the dip is narrower than the gap between two checks
    t = np.linspace(0.0, 80.0, samples)
    deep = motion.q[int(np.argmin(np.abs(motion.t - 2.0)))]
    q = HOME + np.exp(-(((t - 41.13) / 0.1) ** 2))[:, None] * (deep - HOME)
    near = clearance.nearest_on(t, q)["the cell"]
    assert near.t == pytest.approx(41.13, abs=0.02)
    assert near.distance == pytest.approx(clearance.distances(deep)[~clearance.of_self].min(), abs=3e-3)


def test_one_distance_that_is_not_a_number_is_refused(arm: Arm, cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    clearance = Clearance(arm, cell)
    assert np.all(clearance.distances(HOME) > 0)
    real = pin.computeDistance
    nothing = SimpleNamespace(min_distance=np.nan)
    monkeypatch.setattr(pin, "computeDistance", lambda model, data, pair: nothing if pair == 3 else real(model, data, pair))
    with pytest.raises(SafetyStop, match="a distance is not a number"):
        clearance.distances(HOME)


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
        certify(clearance, sheet, "the motion", LEAST, 0.1)
    with pytest.raises(SafetyStop, match="wrong length"):
        clearance.distances(HOME[:5])


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
    certify(clearance, PathSheet(motion, one), "the motion", LEAST, 0.1)
    assert clearance.nearest_on(motion.t, motion.q) == {}
