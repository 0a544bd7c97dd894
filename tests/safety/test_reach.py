"""How far and how fast points of the arm move, also with prismatic joints, meshes and fixed bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety.clear import clear
from safety.collision import Clearance
from safety.reach import fastest_point, joint_reach, spine
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import ConfigError, SafetyStop
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

MODEL = """<mujoco model="lift">
 <compiler angle="radian" inertiafromgeom="false"/>
 <asset><mesh name="ball" vertex="VERTICES"/></asset>
 <worldbody>
  <geom name="foot" type="box" size="0.1 0.1 0.05" pos="0 0 -1"/>
  <body name="lift"><joint name="up" type="slide" axis="0 0 1" range="-0.5 0.5"/>
   <inertial pos="0 0 0" mass="3" diaginertia="0.01 0.01 0.01"/>
   <body name="turn" pos="0 0 0.3"><joint name="turn" axis="0 0 1" range="-3 3"/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
    <geom name="ball" type="mesh" mesh="ball" pos="0.5 0 0"/>
   </body></body>
 </worldbody>
</mujoco>
"""
ARM = """schema = "arm/1"
name = "lift"
model = "model.xml"
joints = ["up", "turn"]
[limits]
q_min = [-0.5, -3.0]
q_max = [0.5, 3.0]
dq_max = [1.0, 3.0]
ddq_max = [10.0, 10.0]
jerk_max = [200.0, 200.0]
tau_max = [200.0, 150.0]
[sensors]
rate = 500.0
encoder_resolution = 1e-5
velocity_noise = [1e-3, 1e-3]
torque_noise = [0.5, 0.5]
[provenance]
all = "made for the tests of the package safety"
"""
CELL = """schema = "cell/1"
name = "lift-cell"
arm = "lift"
driver = "mock"
[[obstacles]]
kind = "plane"
name = "floor"
position = [0.0, 0.0, -2.0]
normal = [0.0, 0.0, 1.0]
"""


@pytest.fixture(scope="module")
def lift(tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, Cell]:
    folder: Path = tmp_path_factory.mktemp("arms")
    (folder / "lift").mkdir()
    rng = np.random.default_rng(5)
    points = rng.normal(size=(40, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1)[:, None]
    text = " ".join(f"{x:.5f}" for x in points.ravel())
    (folder / "lift" / "model.xml").write_text(MODEL.replace("VERTICES", text))
    (folder / "lift" / "arm.toml").write_text(ARM)
    (folder / "cell.toml").write_text(CELL)
    return load_arm(folder / "lift"), load_cell(folder / "cell.toml")


def still(arm: Arm, dq: tuple[float, float]) -> Trajectory:
    """A hundredth of a second at constant speed."""
    t = np.array([0.0, 0.01])
    q = t[:, None] * np.array(dq)
    return Trajectory(t, q, np.tile(dq, (2, 1)), np.zeros((2, 2)))


def test_a_slide_moves_every_point_by_itself_and_lengthens_nothing_that_turns(lift: tuple[Arm, Cell]) -> None:
    arm, _ = lift
    ball = next(s for s in arm.tree.shapes if s.kind == "mesh")
    reach = joint_reach(arm, ball)
    points, radius = spine(ball)
    assert reach[0] == 1.0
    assert radius == 0.0
    assert reach[1] == pytest.approx(np.max(np.linalg.norm(points, axis=1)))


def test_point_speed_of_a_mesh_is_bounded_by_its_box_and_never_too_small(lift: tuple[Arm, Cell]) -> None:
    arm, _ = lift
    ball = next(s for s in arm.tree.shapes if s.kind == "mesh")
    for dq in ((0.4, 0.0), (0.0, 1.0), (0.3, -1.2)):
        speed = fastest_point(still(arm, dq), arm)
        linear = np.array([RigidBody(arm).jacobian(np.zeros((1, 2)), ball.link, p)[0][0] @ dq for p in spine(ball)[0]])
        true = np.linalg.norm(linear, axis=1).max()
        assert true <= speed <= 1.5 * true


def test_a_body_that_stands_has_no_speed_and_can_still_be_hit(lift: tuple[Arm, Cell]) -> None:
    arm, cell = lift
    assert ("ball", "foot") in {tuple(sorted(pair)) for pair in Clearance(arm, cell).pairs}
    clear(still(arm, (0.0, 0.0)), arm, cell)


def test_a_distance_that_is_not_a_number_is_never_free(lift: tuple[Arm, Cell]) -> None:
    arm, cell = lift
    position = arm.tree.position.copy()
    position[1, 2] = np.nan
    with pytest.raises(SafetyStop, match="a distance is not a number"):
        Clearance(replace(arm, tree=replace(arm.tree, position=position)), cell).distances(np.zeros(2))


def test_an_obstacle_in_millimetres_is_refused(lift: tuple[Arm, Cell]) -> None:
    arm, cell = lift
    for far, refused in ((100.0, False), (100.001, True), (-2000.0, True)):
        plane = cell.table.obstacles[0].model_copy(update={"position": [0.0, far, 0.0]})
        there = replace(cell, table=cell.table.model_copy(update={"obstacles": [plane]}))
        if refused:
            with pytest.raises(ConfigError, match="millimetres"):
                Clearance(arm, there)
        else:
            Clearance(arm, there)


def test_a_posture_far_out_of_every_number_is_not_free(lift: tuple[Arm, Cell]) -> None:
    arm, cell = lift
    clearance = Clearance(arm, cell)
    assert (clearance.distances(np.array([1.7e308, 0.0])) <= clearance.margin).any()


def test_without_pairs_there_is_nothing_to_prove_and_nothing_to_show(lift: tuple[Arm, Cell]) -> None:
    arm, cell = lift
    moving = tuple(s for s in arm.tree.shapes if s.link >= 0)
    alone = replace(arm, tree=replace(arm.tree, shapes=moving))
    empty = replace(cell, table=cell.table.model_copy(update={"obstacles": []}))
    clearance = Clearance(alone, empty)
    assert clearance.pairs == ()
    assert clear(still(arm, (0.1, 0.1)), alone, empty, clearance=clearance).verdict.near == {}
