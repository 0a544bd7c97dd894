"""`calib arm new` on a ROS package finds its meshes, guesses nothing and overwrites nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from calib.main import main
from safety.collision import Clearance
from sim.arm import load_arm
from sim.cell import load_cell
from sim.errors import ConfigError
from tests.calib.test_arm_command import error_text

URDF = """<robot name="two"><link name="w"/><link name="l">
  <inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><geometry><mesh filename="package://two_description/meshes/pretty.dae"/></geometry></visual>
  <collision><geometry><mesh filename="package://two_description/meshes/part.obj"/></geometry></collision></link>
  <joint name="j" type="revolute"><parent link="w"/><child link="l"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="5" velocity="2"/></joint></robot>"""


@pytest.fixture
def package(tmp_path):
    home = tmp_path / "two_description"
    (home / "meshes").mkdir(parents=True)
    (home / "urdf").mkdir()
    corners = ["v 0 0 0", "v 0.1 0 0", "v 0 0.1 0", "v 0 0 0.1", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (home / "meshes" / "part.obj").write_text("\n".join(corners))
    (home / "urdf" / "two.urdf").write_text(URDF)
    return home


@pytest.mark.parametrize("with_root", [True, False])
def test_a_ros_package_becomes_an_arm_folder(package, tmp_path, capsys, with_root):
    root = ["--root", str(package)] if with_root else []
    limits = ["--limit", "ddq_max=5", "--limit", "jerk_max=100"]
    assert (
        main(["arm", "new", str(package / "urdf" / "two.urdf"), *root, *limits, "--json", "--out", str(tmp_path / "arm")]) == 0
    )
    assert json.loads(capsys.readouterr().out)["missing"] == []
    arm = load_arm(tmp_path / "arm")
    assert (arm.prior.numbers, arm.prior.unknown) == (None, ["coulomb", "viscous", "rotor", "offset"])
    assert (arm.name, arm.joint_names, arm.incomplete) == ("two", ("j",), ("sensors",))
    assert (arm.dq_max.tolist(), arm.tau_max.tolist(), arm.jerk_max.tolist()) == ([2.0], [5.0], [100.0])
    assert {s.kind for s in arm.tree.shapes} <= {"capsule", "sphere", "mesh"}
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    assert all(any(_holds(shape, corner) for shape in arm.tree.shapes) for corner in corners)


def test_what_nobody_stated_stays_missing_and_is_reported(package, tmp_path, capsys):
    assert main(["arm", "new", str(package / "urdf" / "two.urdf"), "--out", str(tmp_path / "arm")]) == 0
    assert "not stated, and needed before any motion: ddq_max, jerk_max" in " ".join(capsys.readouterr().err.split())
    assert load_arm(tmp_path / "arm").incomplete == ("ddq_max", "jerk_max", "sensors")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--limit", "ddq_max=0"], "above zero"),
        (["--limit", "ddq_max=nan"], "finite"),
        (["--limit", "ddq_max=1,2"], "2 numbers for 1 joints"),
        (["--limit", "speed=1"], "there is no limit 'speed'"),
        (["--limit", "q_min=2"], "is not below q_max"),
        (["--limit", "ddq_max=fast"], "write KEY=N"),
        (["--root", "nowhere"], "there is no such folder"),
        (["--name", "../up"], "letters, digits"),
    ],
)
def test_wrong_answers_are_refused_and_nothing_is_written(package, tmp_path, capsys, arguments, sentence):
    assert main(["arm", "new", str(package / "urdf" / "two.urdf"), *arguments, "--out", str(tmp_path / "arm")]) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "arm").exists()


def test_an_arm_that_is_there_is_not_overwritten(package, tmp_path, capsys):
    command = ["arm", "new", str(package / "urdf" / "two.urdf"), "--out", str(tmp_path / "arm")]
    assert main(command) == 0
    assert main(command) == 2
    assert "is already an arm" in capsys.readouterr().err


def test_a_mesh_may_not_leave_its_package(package, tmp_path, capsys):
    file = package / "urdf" / "two.urdf"
    file.write_text(URDF.replace("two_description/meshes/part.obj", "two_description/../../secret.obj"))
    assert main(["arm", "new", str(file), "--out", str(tmp_path / "arm")]) == 2
    assert "leaves its package" in capsys.readouterr().err


def test_a_missing_collision_mesh_leaves_the_arm_without_a_cleared_motion_until_waived(package, tmp_path, capsys):
    (package / "meshes" / "part.obj").unlink()
    command = ["arm", "new", str(package / "urdf" / "two.urdf"), "--limit", "ddq_max=5", "--limit", "jerk_max=100"]
    assert main([*command, "--out", str(tmp_path / "arm")]) == 0
    assert "link l: collision mesh package://two_description/meshes/part.obj was not found" in error_text(capsys)
    arm = load_arm(tmp_path / "arm")
    assert "shapes" in arm.incomplete
    with pytest.raises(ConfigError, match=r"collision shapes are missing \(l\)"):
        Clearance(arm, load_cell("mock-ur10e"))
    assert main([*command, "--no-shapes", "--out", str(tmp_path / "waived")]) == 0
    assert "shapes" not in load_arm(tmp_path / "waived").incomplete


def test_a_link_without_inertia_is_named(package, tmp_path, capsys):
    file = package / "urdf" / "two.urdf"
    file.write_text(URDF.replace('ixx="1" iyy="1" izz="1"', 'ixx="0" iyy="0" izz="0"'))
    assert main(["arm", "new", str(file), "--out", str(tmp_path / "arm")]) == 0
    assert "link l: the file states no inertia; its 1 kg are a point mass" in error_text(capsys)


def test_a_robot_whose_name_is_none_for_an_arm_is_called_after_its_file(package, tmp_path, capsys):
    file = package / "urdf" / "two.urdf"
    file.write_text(URDF.replace('name="two"', 'name="Prüfarm 1"'), encoding="utf-8")
    file = file.rename(file.with_name("cell-3.urdf"))
    assert main(["arm", "new", str(file), "--out", str(tmp_path / "arm")]) == 0
    assert "'Prüfarm 1' cannot be an arm's name" in error_text(capsys)
    assert load_arm(tmp_path / "arm").name == "cell-3"


def test_limits_in_degrees_are_refused(package, tmp_path, capsys):
    file = package / "urdf" / "two.urdf"
    file.write_text(URDF.replace('lower="-1" upper="1"', 'lower="-120" upper="120"'))
    assert main(["arm", "new", str(file), "--out", str(tmp_path / "arm")]) == 2
    assert "joint j moves from -120 to 120 rad, 38 turns; at most 10 are read (degrees?)" in error_text(capsys)
    file.write_text(URDF.replace('lower="-1" upper="1"', 'lower="-25" upper="25"'))
    assert main(["arm", "new", str(file), "--out", str(tmp_path / "arm")]) == 0


def _holds(shape, point):
    half = shape.size[1] if shape.kind == "capsule" else 0.0
    local = shape.rotation.T @ (point - shape.position)
    if shape.kind == "mesh":
        faces = ConvexHull(shape.vertices).equations
        return bool((faces[:, :3] @ local + faces[:, 3] < 1e-6).all())
    local[2] -= np.clip(local[2], -half, half)
    return np.linalg.norm(local) <= shape.size[0]
