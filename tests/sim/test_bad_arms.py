"""An arm file that breaks a rule is refused with the fault and the file; it is not repaired or read in part."""

import re
import shutil
from pathlib import Path

import pytest

from sim.arm import load_arm
from sim.errors import ConfigError
from sim.resources import shipped_configs


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(shipped_configs() / "arms" / "servo6", tmp_path / "own")
    return tmp_path / "own"


def change(file: Path, pattern: str, replacement: str) -> None:
    text, count = re.subn(pattern, replacement, file.read_text(), count=1, flags=re.MULTILINE | re.DOTALL)
    assert count == 1, pattern
    file.write_text(text)


TOML = {
    "unknown key": (r"^\[limits\]", "[limits]\nspeed_max = 1", "unknown key limits.speed_max; .*known: q_min"),
    "unknown table": (r"^\[limits\]", "[limitz]\n[limits]", "unknown key limitz; did you mean 'limits'"),
    "missing limit": (r"^jerk_max = [^\n]*\n", "", "missing key limits.jerk_max; add it: it is never guessed"),
    "missing name": (r"^name = [^\n]*\n", "", "missing key name"),
    "missing sensors": (r"^\[sensors\].*?(?=^\[prior)", "", "missing key sensors"),
    "incomplete and given": (r"^name = ", 'incomplete = ["dq_max"]\nname = ', "limits.dq_max is given, but incomplete says"),
    "nan": (r"^dq_max = \[[^,]*", "dq_max = [nan", "limits.dq_max.0 = nan"),
    "infinite": (r"^tau_max = \[[^,]*", "tau_max = [inf", "must be finite"),
    "negative": (r"^ddq_max = \[", "ddq_max = [-", "limits.ddq_max.0 = -20.0"),
    "too short": (r"^dq_max = \[[^,]*, ", "dq_max = [", "limits.dq_max has 5 numbers for 6 joints"),
    "swapped": (r"^q_max = \[[^,]*", "q_max = [-9.0", "q_min .* is not below q_max"),
    "continuous above peak": (
        r"^name = ",
        "torque_continuous = [9, 9, 29, 3, 3, 3]\nname = ",
        "torque_continuous of elbow_joint is 29 N m, above its tau_max of 28",
    ),
    "text for a number": (r"^rate = [^\n]*", 'rate = "fast"', "sensors.rate = 'fast'"),
    "other joints": ("elbow_joint", "knee_joint", "list the joints of the model in its order"),
    "not TOML": (r"^name = ", "name == ", "not valid TOML"),
    "duplicate key": (r"^name = ", 'name = "a"\nname = ', "not valid TOML"),
    "model outside": (r"model\.xml", "../model.xml", "leaves the arm's folder"),
    "no model": (r"model\.xml", "other.xml", "cannot be read"),
    "effect of another joint": (
        r"^\[provenance\]",
        '[[effects]]\neffect = "torque_gain"\njoint = "knee"\nparameters = {gain = 1.1}\n[provenance]',
        "joint 'knee'",
    ),
    "effect against the model": (
        r"^\[provenance\]",
        '[[effects]]\neffect = "coulomb_friction"\njoint = "elbow_joint"\nparameters = {coulomb = 9.0}\n[provenance]',
        "but the model file has",
    ),
}
MODEL = {
    "negative mass": (r'mass="0.75"', 'mass="-0.75"', "<inertial> of <body name='.*'> mass=-0.75: a mass cannot be negative"),
    "no mass": (r'mass="0.75"', 'mass="0"', "mass and inertia of moving bodies must be larger"),
    "triangle inequality": (r'fullinertia="0.0009 0.0048 0.0048', 'fullinertia="0.0009 0.0048 0.0068', "triangle inequality"),
    "negative inertia": (r'fullinertia="0.0009', 'fullinertia="-0.0009', "none may be negative"),
    "nan": (r'damping="0.7"', 'damping="nan"', "every number must be finite"),
    "too large": (r'damping="0.7"', 'damping="1e999"', "every number must be finite"),
    "negative damping": (r'damping="0.7"', 'damping="-0.7"', "damping.*must not be negative"),
    "mesh outside": ("<worldbody>", '<asset><mesh file="../x.obj"/></asset><worldbody>', "leaves the folder"),
    "mesh at an address": ("<worldbody>", '<asset><mesh file="http://x/y.obj"/></asset><worldbody>', "not an address"),
    "mesh missing": ("<worldbody>", '<asset><mesh file="x.obj"/></asset><worldbody>', "copy the file there"),
    "doctype": ("^<mujoco", '<!DOCTYPE m [<!ENTITY a "b">]><mujoco', "DOCTYPE or ENTITY"),
    "include": ("<worldbody>", '<include file="model.xml"/><worldbody>', "<include> is not read here"),
    "replicate": ("<worldbody>", '<worldbody><replicate count="9"/>', "<replicate> is not read here"),
    "too deep": ("<worldbody>", "<worldbody>" + "<frame>" * 120 + "</frame>" * 120, "deeper than 100"),
    "duplicate names": ('name="elbow_joint"', 'name="wrist_1_joint"', "repeated name|list the joints"),
    "not closed": ("</mujoco>", "", "not well-formed XML"),
    "two joints in a body": ('<joint name="elbow_joint"', '<joint name="extra"/><joint name="elbow_joint"', "2 joints"),
    "free joint": (
        '<joint name="elbow_joint" ',
        '<joint name="elbow_joint" type="ball" ',
        "neither a hinge|list the joints|ball",
    ),
    "unknown element": ("<worldbody>", "<worlds/><worldbody>", "MuJoCo cannot compile it"),
}


@pytest.mark.parametrize("case", TOML)
def test_arm_toml(folder, case):
    pattern, replacement, sentence = TOML[case]
    change(folder / "arm.toml", pattern, replacement)
    with pytest.raises(ConfigError, match=sentence) as caught:
        load_arm(folder)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize("case", MODEL)
def test_model(folder, case):
    pattern, replacement, sentence = MODEL[case]
    change(folder / "model.xml", pattern, replacement)
    with pytest.raises(ConfigError, match=sentence) as caught:
        load_arm(folder)
    assert str(folder) in str(caught.value)


def test_bytes_that_are_no_text(folder):
    (folder / "model.xml").write_bytes(b"<mujoco>\xff\xfe</mujoco>")
    with pytest.raises(ConfigError, match="not UTF-8 text at byte 8"):
        load_arm(folder)
    (folder / "arm.toml").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match="not UTF-8 text at byte 0"):
        load_arm(folder)


def test_a_mesh_link_out_of_the_folder(folder, tmp_path):
    (tmp_path / "outside.obj").write_text("v 0 0 0")
    (folder / "x.obj").symlink_to(tmp_path / "outside.obj")
    change(folder / "model.xml", "<worldbody>", '<asset><mesh file="x.obj"/></asset><worldbody>')
    with pytest.raises(ConfigError, match="leaves the folder"):
        load_arm(folder)


def test_wrong_names_are_answered_with_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'ur10e'"):
        load_arm("ur10ee")


def test_a_folder_of_an_arms_name_that_is_none_does_not_hide_the_arm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ur10e").mkdir()
    (tmp_path / "recordings").mkdir()
    assert load_arm("ur10e").name == "ur10e"
    with pytest.raises(ConfigError, match=r"recordings/arm\.toml"):
        load_arm("recordings")


def test_a_misspelt_cell_is_a_missing_file_and_no_unknown_arm() -> None:
    with pytest.raises(ConfigError, match=r"nocell\.toml: there is no such file; `calib init` writes a cell"):
        load_arm("nocell.toml")
