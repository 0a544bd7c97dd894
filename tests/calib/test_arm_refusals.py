"""`calib arm new` and `calib import` name what is wrong with a file or an option, and how to correct it."""

import pytest

from calib.main import main


def error_text(capsys):
    return " ".join(capsys.readouterr().err.split())


TWO = """<robot name="two"><link name="base"/><link name="a">{body}</link><link name="b">{body}</link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="3"/></joint>
<joint name="{name}" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}{more}</joint></robot>"""
TWO_BODY = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
TWO_LIMIT = '<limit lower="-2" upper="2" effort="9" velocity="3"/>'


@pytest.mark.parametrize(
    ("name", "limit", "more", "options", "message"),
    [
        ("j1", TWO_LIMIT, "", [], "two joints are named 'j1'; names are unique in a URDF, rename one"),
        ("j2", TWO_LIMIT.replace('lower="-2"', 'lower="3"'), "", [], "joint j2 has lower = 3 above upper = 2; exchange them"),
        ("j2", TWO_LIMIT, '<mimic joint="nowhere"/>', [], "joint j2 mimics 'nowhere', which the file does not have"),
        (
            "j2",
            TWO_LIMIT,
            "",
            ["--lock", "j2=90"],
            "--lock j2=90 is outside its range of -2 to 2 (rad or m; is it in degrees?)",
        ),
        ("j2", TWO_LIMIT, "", ["--tool", "base"], "'base' is the base, which does not move"),
        ("j2", TWO_LIMIT, "", ["--spring", "j2"], "--spring j2: write JOINT=K,Q0"),
    ],
)
def test_what_is_wrong_with_a_urdf_or_an_option_is_named(tmp_path, capsys, name, limit, more, options, message):
    file = tmp_path / "two.urdf"
    file.write_text(TWO.format(name=name, limit=limit, more=more, body=TWO_BODY))
    assert main(["arm", "new", str(file), "--no-shapes", *options, "--numbers", "cad", "--out", str(tmp_path / "arm")]) == 2
    assert message in error_text(capsys)
    assert not (tmp_path / "arm").exists()


def test_a_file_that_must_be_converted_first_is_refused_with_the_way(tmp_path, capsys):
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    assert main(["arm", "new", str(tmp_path / "arm.urdf.xacro"), "--out", str(tmp_path / "arm")]) == 2
    assert "expand a .xacro file with `xacro` first" in error_text(capsys)
    (tmp_path / "log.csv.gz").write_bytes(b"\x1f\x8b\x08" + bytes(40))
    assert main(["import", str(tmp_path / "log.csv.gz"), "--out", str(tmp_path / "log")]) == 2
    assert "compressed with gzip" in error_text(capsys)
