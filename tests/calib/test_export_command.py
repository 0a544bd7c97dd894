"""`calib export` writes files, a table and one JSON document, and a sentence where a format cannot be written."""

import json

from calib.main import main
from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.effects import effect_named

BARE = """<mujoco model="one"><worldbody><body name="rod"><joint name="hinge" axis="0 1 0"/>
  <inertial mass="2" pos="0.3 0 0" diaginertia="0.05 0.05 0.05"/></body></worldbody></mujoco>"""


def test_writes_every_format_and_says_so(tmp_path, capsys):
    assert main(["export", "ur5e", "--out", str(tmp_path / "out")]) == 0
    names = {p.name for p in (tmp_path / "out").iterdir()}
    made = {
        ".xml",
        "_effects.json",
        ".urdf",
        "_isaaclab.json",
        "_friction.csv",
        "_payload.json",
        "_parameters.csv",
        "_parameters.json",
    }
    assert {"run.toml", *(f"ur5e{end}" for end in made)} == names
    out = capsys.readouterr().out
    assert "ur5e.urdf" in out
    assert "ur5e is written as 8 files in " in out


def test_json_names_the_files(tmp_path, capsys):
    assert main(["export", "servo6", "--format", "urdf", "--json", "--out", str(tmp_path / "out")]) == 0
    reply = json.loads(capsys.readouterr().out)
    files = [str(tmp_path / "out" / "servo6.urdf")]
    none = {"left_out": None, "removed_from_mjcf": [], "not_in_urdf": [], "driven_by_friction": [], "masses_unknown": False}
    assert reply == {"arm": "servo6", "files": files, "effects": [], **none}


def test_says_what_plain_mujoco_leaves_out(tmp_path, capsys):
    joint = "elbow_joint"
    effects = [
        ArmEffect("stribeck_friction", joint, {"stiction_excess": 3.0, "stribeck_velocity": 0.1}),
        ArmEffect("thermal_friction", joint, {"relative_drop": 0.3, "time_constant": 60.0}),
        ArmEffect("torque_offset", joint, {"offset": 2.0}),
    ]
    write_arm(tmp_path / "arm", load_arm("ur5e"), effects=effects)
    assert main(["export", str(tmp_path / "arm"), "--json", "--out", str(tmp_path / "one")]) == 0
    forms = {row["effect"]: row["form"] for row in json.loads(capsys.readouterr().out)["effects"]}
    assert forms["stribeck_friction"] == "native"
    assert (forms["thermal_friction"], forms["torque_offset"]) == ("callback", "sensor")
    assert main(["export", str(tmp_path / "arm"), "--out", str(tmp_path / "two")]) == 0
    printed = " ".join("".join(capsys.readouterr()).split())
    assert "import calib.mujoco" in printed
    assert "calib.mujoco.read(model, data)" in printed


def test_an_arm_whose_friction_drives_it_is_written_with_a_warning(tmp_path, capsys):
    law = {p.name: 0.0 for p in effect_named("friction_law").parameters} | {"power_1": -100.0}
    write_arm(tmp_path / "arm", load_arm("ur5e"), effects=[ArmEffect("friction_law", "elbow_joint", law)])
    assert main(["export", str(tmp_path / "arm"), "--out", str(tmp_path / "out")]) == 0
    assert "calib: friction drives elbow_joint within the speed limits of" in " ".join(capsys.readouterr().err.split())


def test_a_bare_model_without_limits_gets_no_urdf_and_the_reason(tmp_path, capsys):
    (tmp_path / "one.xml").write_text(BARE)
    assert main(["export", str(tmp_path / "one.xml"), "--out", str(tmp_path / "out")]) == 0
    assert "no URDF: " in " ".join(capsys.readouterr().err.split())
    assert {p.suffix for p in (tmp_path / "out").iterdir()} == {".xml", ".csv", ".json", ".toml"}
    assert main(["export", str(tmp_path / "one.xml"), "--format", "urdf", "--out", str(tmp_path / "other")]) == 2
    assert "q_min of hinge is not given" in " ".join(capsys.readouterr().err.split())


def test_gravity_that_no_urdf_has_leaves_the_other_formats(tmp_path, capsys):
    write_arm(tmp_path / "arm", load_arm("ur5e"), gravity=[0.0, 0.0, -9.80665])
    assert main(["export", str(tmp_path / "arm"), "--out", str(tmp_path / "out")]) == 0
    assert "no URDF: gravity of 9.80665 m/s^2" in " ".join(capsys.readouterr().err.split())
    assert {p.suffix for p in (tmp_path / "out").iterdir()} == {".xml", ".csv", ".json", ".toml"}


def test_names_what_the_urdf_and_the_model_of_mujoco_leave_out(tmp_path, capsys):
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 3.0, "rest_angle": 0.5})
    write_arm(tmp_path / "arm", load_arm("ur5e"), effects=[spring])
    assert main(["export", str(tmp_path / "arm"), "--out", str(tmp_path / "out")]) == 0
    assert "the URDF leaves out what its format cannot hold: joint spring at elbow_joint" in " ".join(
        capsys.readouterr().err.split()
    )
    assert (
        "<!-- left out, as URDF cannot hold it: joint spring at elbow_joint -->" in (tmp_path / "out" / "ur5e.urdf").read_text()
    )
    (tmp_path / "one.xml").write_text(BARE.replace('<body name="rod">', '<body name="rod" gravcomp="1">'))
    assert main(["export", str(tmp_path / "one.xml"), "--format", "mjcf", "--json", "--out", str(tmp_path / "held")]) == 0
    assert json.loads(capsys.readouterr().out)["removed_from_mjcf"] == ["gravcomp of body rod"]
