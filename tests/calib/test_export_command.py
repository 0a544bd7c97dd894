"""`calib export`: files, a table, one JSON document, and a sentence where a format cannot be written."""

import json

from calib.main import main

BARE = """<mujoco model="one"><worldbody><body name="rod"><joint name="hinge" axis="0 1 0"/>
  <inertial mass="2" pos="0.3 0 0" diaginertia="0.05 0.05 0.05"/></body></worldbody></mujoco>"""


def test_writes_every_format_and_says_so(tmp_path, capsys):
    assert main(["export", "ur5e", "--out", str(tmp_path / "out")]) == 0
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"ur5e.xml", "ur5e.urdf", "ur5e_parameters.csv", "ur5e_parameters.json", "run.toml"} == names
    assert "ur5e.urdf" in capsys.readouterr().out


def test_json_names_the_files(tmp_path, capsys):
    assert main(["export", "servo6", "--format", "urdf", "--json", "--out", str(tmp_path / "out")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"arm": "servo6", "files": [str(tmp_path / "out" / "servo6.urdf")], "left_out": None}


def test_a_bare_model_without_limits_gets_no_urdf_and_is_told_why(tmp_path, capsys):
    (tmp_path / "one.xml").write_text(BARE)
    assert main(["export", str(tmp_path / "one.xml"), "--out", str(tmp_path / "out")]) == 0
    assert "no URDF, which must state every limit: " in " ".join(capsys.readouterr().err.split())
    assert {p.suffix for p in (tmp_path / "out").iterdir()} == {".xml", ".csv", ".json", ".toml"}
    assert main(["export", str(tmp_path / "one.xml"), "--format", "urdf", "--out", str(tmp_path / "other")]) == 2
    assert "q_min of hinge is not given" in " ".join(capsys.readouterr().err.split())
