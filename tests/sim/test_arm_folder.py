"""An arm written to a folder reads back as intended, to the last digit, and plain MuJoCo loads it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.errors import ConfigError
from sim.required import require_limits
from sim.rigid_body import RigidBody
from sim.tree import combined

TREE = ("rotation", "position", "axis", "mass", "com", "inertia", "armature", "damping", "frictionloss", "stiffness", "gravity")
LIMITS = ("q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max")
BARE = """<mujoco model="three"><!-- kept -->
  <compiler {compiler}/>
  <default><default class="soft"><joint damping="0.5"/></default></default>
  <worldbody><body name="one" pos="0 0 0.1"><joint name="a" axis="0 0 1" range="-90 90"/><geom size="0.1" mass="2"/>
    <body name="two" pos="0.3 0 0" euler="90 0 0"><joint class="soft" axis="0 1 0" pos="0.02 0 0.01" stiffness="2" springref="30"/>
      <inertial mass="1" pos="0.1 0 0" diaginertia="0.01 0.02 0.02"/>
      <body name="tool" pos="0.1 0 0"><geom type="box" size="0.02 0.03 0.04" mass="0.3"/></body>
    </body></body></worldbody>
  <actuator><motor joint="a" forcelimited="true" forcerange="-5 5" gear="3"/></actuator>
</mujoco>"""
URDF = """<robot name="two"><link name="world"/>
  <link name="l1"><inertial><origin xyz="0.1 0 0.02" rpy="0.3 0.2 0.1"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0.001" ixz="0" iyy="0.02" iyz="0.002" izz="0.02"/></inertial>
    <collision><origin xyz="0.1 0 0" rpy="0 1.57 0"/><geometry><cylinder radius="0.03" length="0.2"/></geometry></collision></link>
  <link name="l2"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="j1" type="revolute"><origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/><parent link="world"/><child link="l1"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" effort="30" velocity="3"/><dynamics damping="0.4" friction="0.7"/></joint>
  <joint name="j2" type="revolute"><origin xyz="0.2 0 0" rpy="1.2 0 0"/><parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="10" velocity="4"/></joint></robot>"""


def same(a, b):
    for key in TREE:
        np.testing.assert_allclose(getattr(a.tree, key), getattr(b.tree, key), rtol=1e-15, atol=1e-15, err_msg=key)
    for key in LIMITS:
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key), err_msg=key)
    assert (a.joint_names, a.sensors, a.prior, a.effects) == (b.joint_names, b.sensors, b.prior, b.effects)
    assert a.incomplete == b.incomplete


@pytest.mark.parametrize("name", ["servo6", "ur10e", "ur5e"])
def test_round_trip_without_a_change_is_exact(tmp_path, name):
    arm = load_arm(name)
    written = write_arm(tmp_path / "out", arm)
    same(arm, written)
    same(written, write_arm(tmp_path / "again", written))
    assert (tmp_path / "out" / "arm.toml").read_text() == (tmp_path / "again" / "arm.toml").read_text()
    assert (tmp_path / "out" / "model.xml").read_text() == (tmp_path / "again" / "model.xml").read_text()


def test_every_number_arrives_in_full_precision(tmp_path):
    arm, rng = load_arm("ur10e"), np.random.default_rng(3)
    inertials = {}
    for joint in arm.joint_names:
        a = rng.normal(size=(3, 3)) / 7
        square = a @ a.T
        inertials[joint] = (rng.uniform(0.1, 9) / 3, rng.normal(size=3) / 7, np.trace(square) * np.eye(3) - square)
    joints = {j: {"frictionloss": 1 / 3, "damping": 2 / 3, "armature": 1 / 7} for j in arm.joint_names}
    gravity = np.array([0.1, 1 / 3, -9.8]) / 1.00001
    out = write_arm(tmp_path / "out", arm, inertials=inertials, joints=joints, gravity=gravity, provenance={"mass": "a test"})
    for j, (mass, com, inertia) in enumerate(inertials.values()):
        assert out.tree.mass[j] == mass
        np.testing.assert_array_equal(out.tree.com[j], com)
        np.testing.assert_allclose(out.tree.inertia[j], inertia, rtol=0, atol=1e-15)
    assert out.effect("rotor_inertia", "elbow_joint").parameters == {"inertia": 1 / 7}
    np.testing.assert_array_equal(out.tree.frictionloss, np.full(6, 1 / 3))
    np.testing.assert_array_equal(out.gravity, gravity)
    assert out.provenance["mass"] == "a test"
    assert out.provenance["kinematics"] == arm.provenance["kinematics"]


def test_payload_is_a_body_on_the_last_link_and_adds_up(tmp_path):
    arm = load_arm("ur5e")
    first = {"mass": 1.5, "com_x": 0.01, "com_y": 0.0, "com_z": 0.05}
    one = write_arm(tmp_path / "one", arm, effects=[ArmEffect("payload", None, first)])
    values = {"mass": 0.7, "com_x": 0.0, "com_y": 0.02, "com_z": 0.1}
    two = write_arm(tmp_path / "two", one, effects=[ArmEffect("payload", None, values)])
    model = mujoco.MjModel.from_xml_string(two.model_text)
    assert model.body("calib_payload").mass[0] == pytest.approx(2.2)
    link = (arm.tree.mass[5], arm.tree.com[5], arm.tree.inertia[5])
    bodies = [(1.5, np.array([0.01, 0.0, 0.05]), np.zeros((3, 3))), (0.7, np.array([0.0, 0.02, 0.1]), np.zeros((3, 3)))]
    mass, com, inertia = combined([link, *bodies])
    assert two.tree.mass[5] == pytest.approx(mass, rel=1e-15)
    np.testing.assert_allclose(two.tree.com[5], com, rtol=1e-14)
    np.testing.assert_allclose(two.tree.inertia[5], inertia, rtol=1e-13, atol=1e-16)
    third = write_arm(tmp_path / "three", two, inertials={"wrist_3_joint": link})
    np.testing.assert_allclose(third.tree.mass, arm.tree.mass, rtol=1e-15)


def test_effects_go_to_the_model_or_to_arm_toml_and_never_count_twice(tmp_path):
    arm = load_arm("servo6")
    effects = [
        ArmEffect("coulomb_friction", "elbow_joint", {"coulomb": 2.1}, {"coulomb": 0.05}),
        ArmEffect("joint_spring", "wrist_1_joint", {"stiffness": 1.1, "rest_angle": 0.3}),
        ArmEffect("torque_ripple", "elbow_joint", {"amplitude": 0.4, "cycles": 6.0, "phase": 1.0}),
        ArmEffect("torque_gain", "elbow_joint", {"gain": 1.1}, {"gain": 0.01}),
        ArmEffect("base_tilt", None, {"roll": 0.02, "pitch": -0.03}),
        ArmEffect("link_inertia", "elbow_joint", {"mass": 0.9, "com_x": -0.1, "com_y": 0.01, "com_z": 0.02}),
    ]
    out = write_arm(tmp_path / "out", arm, effects=effects)
    assert out.effect("coulomb_friction", "elbow_joint") == effects[0]
    assert out.effect("joint_spring", "wrist_1_joint") == effects[1]
    assert out.effect("torque_ripple", "elbow_joint") == effects[2]
    assert out.effect("torque_gain", "elbow_joint") == effects[3]
    assert not [e for e in out.effects if e.effect in ("base_tilt", "link_inertia", "payload")]
    assert np.linalg.norm(out.gravity) == pytest.approx(9.81)
    assert out.gravity[2] > -9.81
    assert out.tree.mass[2] == 0.9
    assert len({(e.effect, e.joint) for e in out.effects}) == len(out.effects)
    model = mujoco.MjModel.from_xml_string(out.model_text)
    assert model.joint("elbow_joint").frictionloss[0] == 2.1
    assert model.actuator("calib_torque_ripple_elbow_joint").biasprm[:3].tolist() == [0.4, 6.0, 1.0]
    smoother = write_arm(
        tmp_path / "smoother",
        out,
        effects=[ArmEffect("torque_ripple", "elbow_joint", {"amplitude": 0.1, "cycles": 6.0, "phase": 1.0})],
    )
    assert smoother.model_text.count("calib_torque_ripple_elbow_joint") == 1


@pytest.mark.parametrize("compiler", ['angle="degree"', 'angle="degree" inertiafromgeom="true"', 'settotalmass="5"'])
def test_a_bare_model_becomes_a_folder_that_hides_no_gap(tmp_path, compiler):
    (tmp_path / "arm.xml").write_text(BARE.format(compiler=compiler))
    arm = load_arm(tmp_path / "arm.xml")
    written = write_arm(tmp_path / "out", arm)
    same(arm, written)
    assert "<!-- kept -->" in written.model_text
    assert written.incomplete == ("q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max", "sensors")
    with pytest.raises(ConfigError, match=r"ddq_max of a, joint_1 is not given.*\[limits\] of .*arm.toml"):
        require_limits(written, "ddq_max")
    com, inertia = np.array([0.2, 0.01, 0.02]), np.diag([0.01, 0.02, 0.025])
    changed = write_arm(
        tmp_path / "changed",
        written,
        inertials={"joint_1": (1.7, com, inertia)},
        joints={"joint_1": {"springref": 0.7, "damping": 1.0}},
    )
    assert changed.tree.mass[1] == 1.7
    np.testing.assert_allclose(changed.tree.com[1], com, atol=1e-16)
    np.testing.assert_allclose(changed.tree.inertia[1], inertia, atol=1e-16)
    np.testing.assert_allclose(changed.tree.inertia[0], arm.tree.inertia[0], rtol=1e-14)
    assert changed.tree.springref[1] == pytest.approx(0.7, rel=1e-15)
    assert changed.tree.damping.tolist() == [0.0, 1.0]


def test_a_urdf_becomes_full_precision_mjcf_with_the_same_dynamics(tmp_path):
    (tmp_path / "two.urdf").write_text(URDF)
    arm = load_arm(tmp_path / "two.urdf")
    assert arm.dq_max.tolist() == [3.0, 4.0]
    assert arm.tau_max.tolist() == [30.0, 10.0]
    out = write_arm(tmp_path / "out", arm, joints={"j2": {"armature": 0.3}})
    assert out.incomplete == ("ddq_max", "jerk_max", "sensors")
    assert out.tau_max.tolist() == [30.0, 10.0]
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 50, 2))
    tau = RigidBody(arm).inverse_dynamics(q, dq, ddq)
    np.testing.assert_allclose(RigidBody(out).inverse_dynamics(q, dq, ddq), tau, atol=1e-14)
    assert out.tree.frictionloss.tolist() == [0.7, 0.0]
    assert [s.kind for s in out.tree.shapes] == ["cylinder"]


def test_meshes_travel_with_the_arm(tmp_path):
    home = tmp_path / "own"
    (home / "meshes").mkdir(parents=True)
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(str(i + 1) for i in f) for f in faces]
    (home / "meshes" / "part.obj").write_text("\n".join(lines))
    text = BARE.format(compiler='angle="degree" meshdir="meshes"').replace(
        '<geom size="0.1" mass="2"/>', '<geom type="mesh" mesh="part" mass="2"/>'
    )
    (home / "arm.xml").write_text(text.replace("<worldbody>", '<asset><mesh name="part" file="part.obj"/></asset><worldbody>'))
    (home / "unrelated.stl").write_bytes(b"not a mesh, and not named by the model")
    out = write_arm(tmp_path / "out", load_arm(home / "arm.xml"), joints={"a": {"damping": 0.5}})
    assert sorted(p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()) == [
        "arm.toml", "meshes/part.obj", "model.xml",
    ]  # fmt: skip
    assert [s.kind for s in out.tree.shapes] == ["mesh", "box"]


def test_impossible_numbers_are_refused_and_leave_nothing(tmp_path):
    arm = load_arm("ur5e")
    before = write_arm(tmp_path / "arm", arm)
    flat = np.diag([1.0, 0.1, 0.1])
    with pytest.raises(ConfigError, match="triangle inequality"):
        write_arm(tmp_path / "arm", arm, inertials={"elbow_joint": (1.0, np.zeros(3), flat)})
    with pytest.raises(ConfigError, match="negative"):
        write_arm(tmp_path / "arm", arm, inertials={"elbow_joint": (-1.0, np.zeros(3), np.eye(3))})
    with pytest.raises(ConfigError, match="finite"):
        write_arm(tmp_path / "arm", arm, gravity=np.array([0.0, np.nan, -9.81]))
    with pytest.raises(ConfigError, match="elbow_joint"):
        write_arm(tmp_path / "arm", arm, joints={"elbow": {"damping": 1.0}})
    with pytest.raises(ConfigError, match="known: frictionloss"):
        write_arm(tmp_path / "arm", arm, joints={"elbow_joint": {"friction": 1.0}})
    assert [p.name for p in tmp_path.iterdir()] == ["arm"]
    same(load_arm(tmp_path / "arm"), before)


def test_only_an_arm_is_replaced(tmp_path):
    arm = load_arm("ur5e")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "important.txt").write_text("keep")
    with pytest.raises(ConfigError, match="something other"):
        write_arm(tmp_path / "notes", arm)
    written = write_arm(tmp_path / "arm", arm)
    with pytest.raises(ConfigError, match="read from"):
        write_arm(tmp_path / "arm", written)
    assert write_arm(tmp_path / "arm", arm, name="second").name == "second"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm", "notes"]


def test_text_of_arm_toml_escapes_what_looks_like_rows(tmp_path):
    arm = load_arm("ur5e")
    odd = replace(arm, provenance={"a": "[\n  1.0,\n]", "b": 'quote " and \\ back'})
    out = write_arm(tmp_path / "out", odd)
    assert out.provenance == odd.provenance
