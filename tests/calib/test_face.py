"""The public API: its names and types, imports without side effects, and robustness against another `sim` package."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import calib
from calib.main import main

ROOT = Path(__file__).resolve().parents[2]


def _python(code, cwd, code_expected=0):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, timeout=120, check=False)
    assert done.returncode == code_expected, done.stderr
    return done.stdout.strip() or done.stderr.strip()


@pytest.mark.parametrize("name", calib.__all__)
def test_every_public_name_is_there_and_says_what_it_is(name):
    assert getattr(calib, name).__doc__


def test_the_face_is_what_dir_says_and_the_types_say():
    assert dir(calib) == sorted(calib.__all__)
    tree = ast.parse(Path(calib.__file__).read_text())
    typed = {a.asname for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for a in node.names if a.asname}
    assert typed == set(calib.__all__)
    with pytest.raises(AttributeError, match="no attribute 'indentify'; its public names: Arm"):
        _ = calib.indentify


@pytest.mark.parametrize("package", ["calib", "safety", "drivers", "logs", "sim"])
def test_it_is_typed_for_those_who_use_it(package):
    assert (ROOT / package / "py.typed").is_file()


def test_importing_it_imports_nothing_else(tmp_path):
    code = "import sys; before = set(sys.modules); import calib; print(sorted({m.split('.')[0] for m in set(sys.modules) - before}))"
    heavy = {"numpy", "mujoco", "pinocchio", "pydantic", "typer", "sim", "safety", "drivers", "logs"}
    assert not heavy & set(ast.literal_eval(_python(code, tmp_path)))


def test_a_folder_called_sim_beside_the_script_does_not_break_it(tmp_path):
    for name in ("sim", "logs", "drivers", "safety"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('the folder beside the script was imported')")
    (tmp_path / "script.py").write_text("from calib import identify, load_arm, read_log\nprint(load_arm('ur10e').name)\n")
    done = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "ur10e"), done.stderr
    done = subprocess.run(
        [sys.executable, "-m", "calib", "effects", "--json"], capture_output=True, text=True, cwd=tmp_path, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_a_foreign_sim_that_came_first_is_named(tmp_path):
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim" / "__init__.py").write_text("")
    printed = _python("import sim, calib", tmp_path, 1)
    assert "a module 'sim' of another program" in printed
    assert "import calib first" in printed


TWO = """<robot name="two"><link name="w"><collision><geometry><sphere radius="0.03"/></geometry></collision></link>{links}
  <joint name="a" type="revolute"><parent link="w"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="30" velocity="2"/></joint>
  <joint name="b" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="30" velocity="2"/></joint></robot>"""
BODY = """<link name="{0}"><inertial><origin xyz="0.15 0 0"/><mass value="1"/>
  <inertia ixx="0.005" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.03"/></geometry></collision></link>"""
CELL = """schema = "cell/1"
name = "bench"
arm = "{arm}"
driver = "{driver}"
home = [-0.5, 0.6]
"""


@pytest.mark.slow
def test_from_plan_to_fit_by_the_face_alone(tmp_path):
    """The whole workflow in Python on an arm from a URDF. A cell that may have a real arm needs a person's approval."""
    (tmp_path / "two.urdf").write_text(TWO.format(links=BODY.format("a") + BODY.format("b")))
    made = ["arm", "new", str(tmp_path / "two.urdf"), "--limit", "ddq_max=8", "--limit", "jerk_max=200", "--numbers", "cad"]
    assert main([*made, "--out", str(tmp_path / "arm")]) == 0
    (tmp_path / "bench.toml").write_text(CELL.format(arm=tmp_path / "arm", driver="mock"))
    arm, cell = calib.load_arm(tmp_path / "arm"), calib.load_cell(tmp_path / "bench.toml")
    session = calib.Session(period=6.0, periods=1, tries=5, starts=0, probes=False, speeds=(0.2,), cruise=0.5, chirp=3.0)
    plan = calib.plan(arm, cell, session, folder=tmp_path / "plan")
    (tmp_path / "real.toml").write_text(CELL.format(arm=tmp_path / "arm", driver="can_servo"))
    with pytest.raises(calib.CalibError):
        calib.record(plan, calib.load_cell(tmp_path / "real.toml"), folder=tmp_path / "no")
    done = calib.record(plan, cell, folder=tmp_path / "logs", operator="a test")
    logs = [calib.read_log(path, arm.joint_names) for path in done.logs.values()]
    assert [log.q.shape[1] for log in logs] == [2, 2, 2]
    assert calib.identify(arm, logs[:2], logs[2:]).arm.joint_names == arm.joint_names
