"""The elements of an exported model act as the effects do, whatever the model around them sets as defaults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sim.arm import Arm, ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.export import export
from sim.mujoco_export import exported_model
from sim.new_arm import read_model
from sim.slip import SLIP_WIDTH

ONE = """<mujoco model="one"><compiler angle="radian"/><option gravity="0 0 0"/>{default}<worldbody><body name="link">
  <joint name="hinge" axis="0 0 1" armature="{armature}" frictionloss="0.5"/>
  <inertial mass="1" pos="0 0 0" diaginertia="0.2 0.2 {inertia}"/></body></worldbody>
  <actuator><motor name="m" joint="hinge"/></actuator></mujoco>"""
DEFAULTS = """<default><motor gear="100" forcelimited="true" forcerange="-0.1 0.1" ctrllimited="true" ctrlrange="-1 1"/>
  <general armature="1e-5"/><tendon stiffness="50" damping="5" frictionloss="2"/></default>"""
STRIBECK = ArmEffect("stribeck_friction", "hinge", {"stiction_excess": 0.3, "stribeck_velocity": 0.05})


def one(folder: Path, inertia: float = 0.02, armature: float = 0.05, default: str = "") -> Arm:
    file = folder / "one.xml"
    file.write_text(ONE.format(default=default, inertia=inertia, armature=armature))
    return load_arm(file)


def after(model: mujoco.MjModel, torque: float, seconds: float) -> float:
    """Speed of the hinge after a constant torque, rad/s."""
    data = mujoco.MjData(model)
    while data.time < seconds:
        data.qfrc_applied[0] = torque
        mujoco.mj_step(model, data)
    return float(data.qvel[0])


def compiled(arm: Arm) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(exported_model(arm).text)


@pytest.mark.parametrize("default", ["", DEFAULTS])
def test_stribeck_friction_adds_no_inertia(tmp_path: Path, default: str) -> None:
    """Far beyond the Stribeck speed the torque is that of Coulomb friction, so that speed = (torque - level) t / inertia."""
    own = one(tmp_path, default=default)
    with_friction = write_arm(tmp_path / "arm", own, effects=[*own.effects, STRIBECK])
    torque, level = 5.0, 0.5
    inertia = 0.02 + float(own.tree.armature[0])
    expected = (torque - level) / inertia * 0.5
    # it starts against stiction, for a few milliseconds
    assert after(compiled(with_friction), torque, 0.5) == pytest.approx(expected, rel=5e-3)


def test_inertia_that_cannot_be_taken_off_is_stated(tmp_path: Path) -> None:
    own = one(tmp_path, armature=0.0)
    arm = write_arm(tmp_path / "arm", own, effects=[*own.effects, STRIBECK])
    errors = [row["error"] for row in exported_model(arm).table["effects"] if row["effect"] == "stribeck_friction"]
    assert len(errors) == 1
    assert "more inertia" in errors[0]
    more = int(errors[0].partition("% more")[0].split()[-1])
    slower = 4.5 / 0.02 * 0.5 / after(compiled(arm), 5.0, 0.5) - 1
    assert 100 * slower == pytest.approx(more, abs=1.0)


def test_defaults_for_the_users_motors_do_not_change_passive_elements(tmp_path: Path) -> None:
    asymmetric = ArmEffect("asymmetric_friction", "hinge", {"half_difference": 0.3})
    found = []
    for default in ("", DEFAULTS):
        own = one(tmp_path, default=default)
        arm = write_arm(tmp_path / f"arm{len(found)}", own, effects=[*own.effects, asymmetric])
        inertia = 0.02 + float(arm.tree.armature[0])
        found.append([after(compiled(arm), sign * 2.0, 0.5) * inertia for sign in (1, -1)])
        again = load_arm(arm.model_path.parent)
        assert after(compiled(again), 2.0, 0.5) * inertia == pytest.approx(found[-1][0])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)
    assert abs(found[0][0] + found[0][1]) == pytest.approx(2 * 0.3 * 0.5, rel=0.02)


@pytest.mark.parametrize("effect", ["load_dependent_friction", "thermal_friction"])
def test_friction_that_varies_needs_no_dry_friction_to_be_exported(tmp_path: Path, effect: str) -> None:
    own = one(tmp_path)
    bare = [e for e in own.effects if e.effect != "coulomb_friction"]
    item = ArmEffect(
        effect, "hinge", {"coefficient": 0.1} if effect[0] == "l" else {"relative_drop": 0.2, "time_constant": 100.0}
    )
    arm = write_arm(tmp_path / "arm", replace(own, effects=tuple(bare)), effects=[*bare, item])
    export(arm, tmp_path / "out", ["mjcf"])


def test_friction_of_a_varying_level_builds_up_over_the_same_distance(tmp_path: Path) -> None:
    own = one(tmp_path, inertia=0.2)
    arm = write_arm(
        tmp_path / "arm", own, effects=[*own.effects, ArmEffect("load_dependent_friction", "hinge", {"coefficient": 0.1})]
    )
    law = exported_model(arm).table["dry_friction"]["hinge"]
    assert law["stiffness"] == pytest.approx(0.5 / SLIP_WIDTH)
    assert law["stiffest"] > law["stiffness"]


def test_two_motors_share_the_limit_of_their_joint(tmp_path: Path) -> None:
    file = tmp_path / "one.xml"
    text = ONE.format(default="", inertia=0.02, armature=0.05)
    file.write_text(text.replace("</actuator>", '<motor name="again" joint="hinge" gear="2"/></actuator>'))
    model = compiled(replace(load_arm(file), tau_max=np.array([10.0])))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1e3
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[0] == pytest.approx(10.0)


def test_a_soft_gear_turns_about_the_axis_of_its_frame(tmp_path: Path) -> None:
    file = tmp_path / "one.xml"
    text = ONE.format(default="", inertia=0.02, armature=0.05)
    hinge = text[text.index("<joint") : text.index("/>", text.index("<joint")) + 2]
    file.write_text(text.replace(hinge, f'<frame pos="0.1 0 0" euler="0.5 0 0">{hinge}</frame>'))
    own = load_arm(file)
    soft = write_arm(
        tmp_path / "arm", own, effects=[*own.effects, ArmEffect("joint_elasticity", "hinge", {"stiffness": 500.0})]
    )
    model = compiled(soft)
    for joint in range(2):
        np.testing.assert_allclose(model.jnt_axis[joint], own.tree.axis[0], atol=1e-12)
        assert abs(model.jnt_axis[joint][2]) < 0.9


def test_joints_without_names_get_names(tmp_path: Path) -> None:
    file = tmp_path / "one.xml"
    text = ONE.format(default="", inertia=0.02, armature=0.05).replace(' name="hinge"', "")
    file.write_text(text[: text.index("<actuator>")] + "</mujoco>")
    arm, _ = read_model(file, tmp_path)
    model = compiled(write_arm(tmp_path / "arm", arm))
    assert mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, 0) == arm.joint_names[0] == "joint_0"
