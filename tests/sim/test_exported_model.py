"""The exported MuJoCo model has the arm's limits, gear ratios, keyframes, soft gears and contacts, and no other effects."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import calib.mujoco
from sim import exported
from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.errors import ConfigError
from sim.export import export, parameter_table
from sim.mujoco_export import exported_model
from sim.new_arm import read_model
from sim.plant_model import plant_model
from sim.postures import postures
from sim.rigid_body import RigidBody
from tests.sim.inverse_dynamics import inverse_dynamics

TWO = """<mujoco model="two"><compiler angle="radian"/><option gravity="0 0 -9.81" {option}/><worldbody><body name="upper" pos="0 0 0.1" {body}>
  <joint name="first" axis="0 1 0" range="-2 2" {joint}/><inertial mass="3" pos="0 0.01 0.2" diaginertia="0.03 0.03 0.01"/>
  <body name="lower" pos="0 0 0.4"><joint name="second" axis="1 0 0"/><inertial mass="2" pos="0 0.01 0.2" diaginertia="0.03 0.03 0.01"/></body>
  </body></worldbody>{more}
  <actuator><motor name="m1" joint="first" gear="10" ctrlrange="-5 5" {motor}/><motor joint="second" ctrlrange="-50 50"/></actuator></mujoco>"""
EMPTY = dict.fromkeys(("option", "body", "joint", "more", "motor"), "")


def two(folder, **parts):
    file = folder / "two.xml"
    file.write_text(TWO.format(**(EMPTY | parts)))
    return file


def model_of(arm):
    return mujoco.MjModel.from_xml_string(exported_model(arm).text)


def test_keeps_the_effects_of_the_models_that_were_used_last(monkeypatch, tmp_path):
    monkeypatch.setattr(exported, "MODELS", 2)
    first, second, third = (model_of(load_arm(two(tmp_path, joint=f'damping="{k}"'))) for k in (1, 2, 3))
    of = exported.ExportedArm.all_of
    known, other = of(first), of(second)
    assert known
    assert of(first) is known
    assert of(third) is not known
    assert of(first) is known
    assert of(second) is not other


def torque_of(arm, q, dq, ddq):
    """Torque (N, n) N m of bodies, damping, reflected inertia and springs."""
    tree = arm.tree
    passive = tree.damping * dq + tree.armature * ddq + tree.stiffness * (q - tree.springref)
    return RigidBody(arm).inverse_dynamics(q, dq, ddq) + passive


FOREIGN = {
    "gravcomp of body upper": {"body": 'gravcomp="1"'},
    "higher-order damping of joint first": {"joint": 'damping="1 2 3"'},
    "higher-order stiffness of joint first": {"joint": 'stiffness="10 20 30" springref="0.3"'},
    "option density, viscosity": {"option": 'density="1000" viscosity="0.9"'},
    "stiffness, damping, armature and friction of tendon t": {
        "more": '<tendon><fixed name="t" stiffness="20" armature="0.5"><joint joint="first" coef="1"/><joint joint="second" coef="-1"/></fixed></tendon>'
    },
    "what the options disable: gravity, actuatorgroupdisable": {
        "option": 'actuatorgroupdisable="0"',
        "more": '<option><flag gravity="disable"/></option>',
    },
    "what the options disable: damper": {"more": '<option><flag damper="disable"/></option>'},
    "equality tied": {"more": '<equality><joint name="tied" joint1="first" joint2="second"/></equality>'},
}


@pytest.mark.parametrize(("what", "parts"), [*FOREIGN.items(), ("", {"motor": 'armature="0.002" damping="0.003"'})])
def test_computes_the_torque_of_the_arm_whatever_its_source_adds(what, parts, tmp_path):
    """The export names what it left out. Armature and damping of a motor count at the joint."""
    arm = load_arm(two(tmp_path, **parts))
    exported, rng = exported_model(arm), np.random.default_rng(1)
    q, dq, ddq = (rng.uniform(-1, 1, (20, 2)) * scale for scale in (1, 2, 5))
    torque = inverse_dynamics(mujoco.MjModel.from_xml_string(exported.text), q, dq, ddq)
    np.testing.assert_allclose(torque, torque_of(arm, q, dq, ddq), atol=1e-9)
    assert exported.removed == ([what] if what else [])
    assert [note for note in read_model(two(tmp_path, **parts), tmp_path)[1] if what and what in note] or not what


def test_a_motor_keeps_no_share_of_what_is_written_at_its_joint(tmp_path):
    arm = load_arm(two(tmp_path, motor='armature="0.002" damping="0.003"'))
    assert arm.effect("rotor_inertia", "first").parameters["inertia"] == pytest.approx(0.2)
    read = write_arm(tmp_path / "arm", arm, joints={"first": {"armature": 0.5}})
    assert read.tree.armature[0] == 0.5
    assert read.tree.damping[0] == pytest.approx(0.3)


def test_has_the_limits_of_the_arm(tmp_path):
    words = ["arm", "new", str(two(tmp_path)), "--limit", "q_min=-1", "--limit", "q_max=1.5", "--limit", "tau_max=2.5"]
    words += ["--limit", "dq_max=3", "--limit", "ddq_max=5", "--limit", "jerk_max=100", "--out", str(tmp_path / "arm")]
    from calib.main import main

    assert main(words) == 0
    model = model_of(load_arm(tmp_path / "arm"))
    np.testing.assert_allclose(model.jnt_range, [[-1, 1.5]] * 2)
    assert model.jnt_limited.all()
    np.testing.assert_allclose(model.actuator_forcerange[:2], [[-0.25, 0.25], [-2.5, 2.5]])


def test_reads_the_torque_of_geared_motors_at_the_joint(tmp_path):
    model = calib.mujoco.load(export(load_arm(two(tmp_path)), tmp_path / "out", ["mjcf"])[0])
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5, 2.0
    mujoco.mj_step(model, data)
    tau = calib.mujoco.read(model, data).tau
    mujoco.set_mjcb_passive(None)
    np.testing.assert_allclose(tau, [5.0, 2.0])


def test_sums_the_torque_of_all_motors_of_a_joint(tmp_path):
    file = two(tmp_path)
    file.write_text(file.read_text().replace("</actuator>", '<motor joint="first" gear="3"/></actuator>'))
    model = calib.mujoco.load(export(load_arm(file), tmp_path / "out", ["mjcf"])[0])
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5, 0.0, 1.0
    mujoco.mj_step(model, data)
    tau = calib.mujoco.read(model, data).tau
    mujoco.set_mjcb_passive(None)
    np.testing.assert_allclose(tau, [8.0, 0.0])


def test_tells_the_motors_of_joints_with_like_names_apart(tmp_path):
    """A comment does not count as a motor: geared motors after it keep their own limits."""
    file = two(tmp_path)
    text = file.read_text().replace("second", "first_1").replace("<actuator>", "<actuator><!-- two drives -->")
    file.write_text(text.replace("</actuator>", '<motor joint="first" gear="3" ctrlrange="-1 1"/></actuator>'))
    arm = replace(load_arm(file), tau_max=np.array([20.0, 5.0]))
    model = mujoco.MjModel.from_xml_string(exported_model(arm).text)
    np.testing.assert_allclose(model.actuator_forcerange[:3, 1], [1.0, 5.0, 10.0 / 3])  # two motors share 20 N m
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5, 2.0, 1.0
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(calib.mujoco.read(model, data).tau, [8.0, 2.0])


def test_a_soft_gear_leaves_keyframes_where_they_are(tmp_path):
    keys = '<keyframe><key name="home" qpos="0.2 0.3" qvel="1 2" ctrl="0 0.3"/></keyframe>'
    soft = ArmEffect("joint_elasticity", "first", {"stiffness": 2e4})
    arm = write_arm(tmp_path / "arm", load_arm(two(tmp_path, more=keys)), effects=[soft])
    model = model_of(arm)
    assert [model.joint(k).name for k in range(3)] == ["first", "first:twist", "second"]
    np.testing.assert_allclose(model.key_qpos, [[0.2, 0.0, 0.3]])
    np.testing.assert_allclose(model.key_qvel, [[1.0, 0.0, 2.0]])


@pytest.mark.parametrize(
    "effect",
    [
        ArmEffect("joint_elasticity", "first", {"stiffness": 1e4}),
        ArmEffect("backlash", "first", {"half_gap": 0.002}),
    ],
    ids=lambda e: e.effect,
)
def test_a_soft_gear_behind_a_motor_without_inertia_can_be_simulated(effect, tmp_path):
    arm = write_arm(tmp_path / "arm", load_arm(two(tmp_path)), effects=[effect])
    exported = exported_model(arm)
    for model in (mujoco.MjModel.from_xml_string(exported.text), plant_model(arm, 0.0005, ())[0]):
        data = mujoco.MjData(model)
        for _ in range(1000):
            mujoco.mj_step(model, data)
        assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 0
        assert np.abs(data.qvel).max() < 20.0
    raised = [row["error"] for row in exported.table["effects"] if row["effect"] == effect.effect]
    assert ("reflected inertia raised to 0.0025 kg m^2" in raised[0]) == (effect.effect == "joint_elasticity")


LINKS = """<robot name="three">{links}{joints}</robot>"""
LINK = """<link name="l{k}"><inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 {z}"/><geometry><cylinder radius=".06" length="{length}"/></geometry></collision></link>"""
JOINT = """<joint name="j{k}" type="revolute"><parent link="l{up}"/><child link="l{k}"/><origin xyz="0 0 {z}"/><axis xyz="{axis}"/>
  <limit lower="-1" upper="1" effort="50" velocity="2"/></joint>"""


def test_bodies_that_are_built_into_each_other_do_not_touch(tmp_path):
    """Base and first link overlap at their joint, and so do the first and third links around a short second one."""
    links = "".join(
        LINK.format(k=k, z=z, length=length) for k, z, length in ((0, 0.0, 0.3), (1, 0.1, 0.3), (2, 0.0, 0.02), (3, 0.2, 0.3))
    )
    axes = ("0 0 1", "0 1 0", "1 0 0")
    joints = "".join(JOINT.format(k=k + 1, up=k, z=(0.1, 0.25, 0.0)[k], axis=axes[k]) for k in range(3))
    (tmp_path / "three.urdf").write_text(LINKS.format(links=links, joints=joints))
    arm = load_arm(tmp_path / "three.urdf")
    model = model_of(arm)
    data, lasting = mujoco.MjData(model), None
    for q in postures(arm):
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        here = {tuple(sorted(pair)) for pair in model.geom_bodyid[data.contact.geom].tolist()}
        lasting = here if lasting is None else lasting & here
    assert not lasting
    excluded = {frozenset((model.body(int(s) >> 16).name, model.body(int(s) & 0xFFFF).name)) for s in model.exclude_signature}
    assert frozenset(("calib_base", "l1")) in excluded


def test_an_export_is_no_arm(tmp_path):
    file = export(load_arm("ur5e"), tmp_path, ["mjcf"])[0]
    with pytest.raises(ConfigError, match="is an export of calib"):
        load_arm(file)


def test_the_urdf_keeps_reflected_inertia_for_its_own_reader(tmp_path):
    export(load_arm("ur5e"), tmp_path, ["urdf"])
    (tmp_path / "staging").mkdir()
    arm, _ = read_model(tmp_path / "ur5e.urdf", tmp_path / "staging")
    np.testing.assert_allclose(arm.tree.armature, load_arm("ur5e").tree.armature)


def test_a_slide_has_the_units_of_a_force(tmp_path):
    file = two(tmp_path)
    file.write_text(
        file.read_text().replace('<joint name="second" axis="1 0 0"/>', '<joint name="second" type="slide" axis="1 0 0"/>')
    )
    rows = {(r["joint"], r["parameter"]): r["unit"] for r in parameter_table(load_arm(file))["parameters"]}
    assert rows["second", "tau_max"] == "N"
    assert rows["second", "viscous_friction.viscous"] == "N*s/m"
    assert rows["second", "rotor_inertia.inertia"] == "kg"
    assert rows["second", "inertia_xx"] == "kg*m^2"
    assert rows["first", "tau_max"] == "N*m"
