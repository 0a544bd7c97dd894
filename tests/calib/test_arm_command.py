"""`calib arm new` turns a ROS URDF into an arm folder and guesses nothing."""

import io

import numpy as np
import pinocchio as pin
import pytest

from calib.main import main
from sim.arm import load_arm
from sim.errors import ConfigError
from sim.prior import spread
from sim.required import require_identified, require_masses
from sim.rigid_body import RigidBody

GRIPPER = """<robot name="grip"><link name="w"/>
  <transmission name="t"><type>x</type><joint name="a"/><mechanicalReduction>nan</mechanicalReduction></transmission>
  <gazebo><plugin name="p" filename="libp.so"/></gazebo>
  {links}
  <joint name="a" type="revolute"><parent link="w"/><child link="a"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="2"/><dynamics damping="0.1" friction="0.2"/></joint>
  <joint name="b" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
  <joint name="hand" type="fixed"><parent link="b"/><child link="hand"/><origin xyz="0.2 0 0" rpy="0.3 0 0"/></joint>
  <joint name="f1" type="prismatic"><parent link="hand"/><child link="f1"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="2"/></joint>
  <joint name="f2" type="prismatic"><parent link="hand"/><child link="f2"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="2"/><mimic joint="f1"/></joint></robot>"""
BODY = """<link name="{0}"><inertial><origin xyz="0.1 0.02 0.03"/><mass value="{1}"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0.001" ixz="0" iyz="0"/></inertial>
  <collision><geometry><sphere radius="0.02"/></geometry></collision></link>"""


@pytest.fixture
def gripper(tmp_path):
    file = tmp_path / "grip.urdf"
    file.write_text(
        GRIPPER.format(links="".join(BODY.format(name, 1 + k) for k, name in enumerate(["a", "b", "hand", "f1", "f2"])))
    )
    return file


@pytest.mark.parametrize("choice", [["--lock", "f1=0.02"], ["--lock", "f*=0.02"], ["--joints", "a,b", "--lock", "f1=0.02"]])
def test_locked_joints_leave_the_dynamics_of_the_others_as_they_were(gripper, tmp_path, choice):
    assert main(["arm", "new", str(gripper), *choice, "--numbers", "cad", "--out", str(tmp_path / "arm")]) == 0
    arm = load_arm(tmp_path / "arm")
    assert (arm.joint_names, len(arm.tree.shapes)) == (("a", "b"), 5)
    whole = pin.buildModelFromUrdf(str(gripper))
    rng = np.random.default_rng(1)
    for q, dq, ddq in rng.normal(size=(5, 3, 2)):
        fingers = np.array([0.02, 0.02])
        expected = pin.rnea(whole, whole.createData(), np.r_[q, fingers], np.r_[dq, 0, 0], np.r_[ddq, 0, 0])[:2]
        assert RigidBody(arm).inverse_dynamics(q[None], dq[None], ddq[None])[0] == pytest.approx(expected, abs=1e-9)


def test_a_follower_stands_still_and_a_tool_ends_the_chain(gripper, tmp_path, capsys):
    assert main(["arm", "new", str(gripper), "--numbers", "cad", "--out", str(tmp_path / "arm")]) == 0
    assert load_arm(tmp_path / "arm").joint_names == ("a", "b", "f1")
    printed = error_text(capsys)
    assert "joint f2 follows f1: it is held still at 0" in printed
    assert "joint f1 slides at the end of the arm" in printed
    assert main(["arm", "new", str(gripper), "--tool", "hand", "--out", str(tmp_path / "tool")]) == 0
    assert load_arm(tmp_path / "tool").joint_names == ("a", "b")


def test_branches_and_unknown_joints_are_asked_about(gripper, tmp_path, capsys):
    gripper.write_text(gripper.read_text().replace('<mimic joint="f1"/>', ""))
    command = ["arm", "new", str(gripper), "--out", str(tmp_path / "arm")]
    assert main(command) == 2
    assert "joints f1 and f2 are both attached to b; an arm is one chain" in error_text(capsys)
    assert main([*command, "--lock", "g1"]) == 2
    assert "has no joint 'g1'" in error_text(capsys)
    assert main([*command, "--tool", "handle"]) == 2
    assert "'handle' is no link of the file; did you mean 'hand'" in error_text(capsys)
    assert main([*command, "--lock", "*"]) == 2
    assert "no joint is left to move" in error_text(capsys)


def test_masses_that_nobody_knows_are_unknown_to_every_fit(gripper, tmp_path, capsys):
    gripper.write_text(gripper.read_text().replace('<mass value="1"/>', '<mass value="0"/>'))
    command = ["arm", "new", str(gripper), "--tool", "hand"]
    assert main([*command, "--out", str(tmp_path / "no")]) == 2
    assert "no mass for a; give the links their <inertial>, or use --geometry-only" in error_text(capsys)
    assert main([*command, "--geometry-only", "--torque-at", "joint", "--out", str(tmp_path / "arm")]) == 0
    arm = load_arm(tmp_path / "arm")
    assert (arm.prior.numbers, arm.torque_at) == ("unknown", "joint")
    assert arm.prior.mass >= 1
    assert arm.tree.mass.min() > 0.1
    with pytest.raises(ConfigError, match="masses are unknown"):
        require_masses(arm)
    (tmp_path / "log.csv").write_text("timestamp,actual_q_0\n")
    assert main(["diagnose", str(tmp_path / "arm"), str(tmp_path / "log.csv"), "--out", str(tmp_path / "run")]) == 2
    assert "a diagnosis would find their error and nothing else" in error_text(capsys)
    (tmp_path / "log.csv").write_text("timestamp,actual_q_0\n")
    assert main(["validate", str(tmp_path / "arm"), str(tmp_path / "log.csv"), "--out", str(tmp_path / "run")]) == 2
    assert "identify them first (`calib identify" in error_text(capsys)
    assert not (tmp_path / "run").exists()
    assert main(["export", str(tmp_path / "arm"), "--out", str(tmp_path / "files")]) == 0
    assert "are unknown: the files hold stand-ins with which no simulation is true" in error_text(capsys)


def test_an_inertia_that_no_body_has_is_named_unless_it_is_not_the_arms_or_only_guessed(gripper, tmp_path, capsys):
    text = gripper.read_text()
    gripper.write_text(text.replace('izz="0.025"', 'izz="0.25"', 1))
    command = ["arm", "new", str(gripper), "--lock", "f1"]
    assert main([*command, "--numbers", "cad", "--out", str(tmp_path / "no")]) == 2
    assert "inertia of link a has principal moments" in error_text(capsys)
    assert main([*command, "--lock", "a", "--numbers", "cad", "--out", str(tmp_path / "b")]) == 0, (
        "a stands still: nothing feels it"
    )
    assert main([*command, "--numbers", "guessed", "--out", str(tmp_path / "guessed")]) == 0
    assert "the nearest possible one is used" in load_arm(tmp_path / "guessed").provenance["left out"]
    gripper.write_text(text.replace('ixx="0.01" iyy="0.02" izz="0.025" ixy="0.001"', 'ixx="0" iyy="0" izz="0" ixy="0"', 1))
    assert main([*command, "--numbers", "cad", "--out", str(tmp_path / "point")]) == 0
    assert load_arm(tmp_path / "point").tree.inertia[0].max() < 1e-5


def test_friction_is_free_where_nobody_measured_it_and_relative_where_somebody_did(gripper, tmp_path):
    assert main(["arm", "new", str(gripper), "--tool", "hand", "--numbers", "cad", "--out", str(tmp_path / "cad")]) == 0
    assert main(["arm", "new", str(gripper), "--tool", "hand", "--numbers", "measured", "--out", str(tmp_path / "known")]) == 0
    free, known = spread(load_arm(tmp_path / "cad")), spread(load_arm(tmp_path / "known"))
    assert free["coulomb"].tolist() == pytest.approx([0.5, 0.5])
    assert free["viscous"].tolist() == pytest.approx([0.25, 0.25])
    assert known["coulomb"].tolist() == pytest.approx([0.04 * 0.2, 0.5]), "a zero states nothing"
    assert known["viscous"].tolist() == pytest.approx([0.04 * 0.1, 0.25])
    assert (known["rotor"] > 0.01).all()


def test_what_is_known_of_the_drives_is_stated_and_no_more(gripper, tmp_path, capsys):
    command = ["arm", "new", str(gripper), "--tool", "hand", "--numbers", "cad"]
    facts = ["--drive", "coulomb=0.3,0.1", "--drive", "inertia=0.02"]
    assert main([*command, *facts, "--out", str(tmp_path / "arm")]) == 0
    arm = load_arm(tmp_path / "arm")
    assert arm.prior.unknown == ["viscous", "offset"]
    assert arm.tree.frictionloss.tolist() == [0.3, 0.1]
    assert arm.tree.armature.tolist() == [0.02, 0.02]
    wide = spread(arm)
    assert wide["coulomb"].tolist() == pytest.approx([0.09, 0.03])
    assert wide["rotor"].tolist() == pytest.approx([0.002, 0.002])
    assert wide["viscous"].tolist() == pytest.approx([0.25, 0.25]), "as wide as an ordinary drive has it"


@pytest.mark.parametrize(
    "fact", ["coulomb=0", "coulomb=nan", "coulomb=-1", "coulomb=1,2,3", "rubbing=1", "coulomb", "inertia=x", "viscous=inf"]
)
def test_a_fact_of_a_drive_that_states_nothing_is_refused(gripper, tmp_path, capsys, fact):
    assert main(["arm", "new", str(gripper), "--tool", "hand", "--drive", fact, "--out", str(tmp_path / "arm")]) == 2
    assert not (tmp_path / "arm").exists()


def test_a_spring_that_is_stated_is_the_arms_with_its_tolerance(gripper, tmp_path, capsys):
    command = ["arm", "new", str(gripper), "--tool", "hand", "--numbers", "cad"]
    assert main([*command, "--out", str(tmp_path / "bare")]) == 0
    joint = load_arm(tmp_path / "bare").joint_names[0]
    assert main([*command, "--spring", f"{joint}=3,-12.5", "--out", str(tmp_path / "arm")]) == 0
    spring = load_arm(tmp_path / "arm").effect("joint_spring", joint)
    assert spring is not None
    assert spring.parameters == {"stiffness": 3.0, "rest_angle": -12.5}
    assert spring.std == {"stiffness": pytest.approx(0.15)}
    for fact in ("nowhere=3,0", f"{joint}=0,0", f"{joint}=3", f"{joint}=3,nan", f"{joint}=-1,0"):
        assert main([*command, "--spring", fact, "--out", str(tmp_path / "no")]) == 2
        assert "--spring" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_a_drive_on_a_bench_is_an_arm_of_one_joint(tmp_path):
    limits = ["--limit", "tau_max=2", "--limit", "dq_max=6"]
    assert main(["arm", "drive", "pendulum", "--load", "0.49,0.1", *limits, "--out", str(tmp_path / "p")]) == 0
    arm = load_arm(tmp_path / "p")
    hanging, level = RigidBody(arm).inverse_dynamics(np.array([[0.0], [np.pi / 2]]), np.zeros((2, 1)), np.zeros((2, 1)))[:, 0]
    assert (hanging, abs(level)) == pytest.approx((0.0, 0.49 * 0.1 * 9.81), abs=1e-12)
    assert arm.prior.numbers == "measured"
    assert main(["arm", "drive", "free", *limits, "--joint", "m1", "--out", str(tmp_path / "f")]) == 0
    arm = load_arm(tmp_path / "f")
    assert (arm.joint_names, arm.prior.numbers) == (("m1",), "unknown")
    require_identified(arm, "")  # a diagnosis fits its one load with everything else
    assert RigidBody(arm).inverse_dynamics(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))[0, 0] == pytest.approx(
        0.0, abs=1e-12
    )


SERVOS = """<mujoco><worldbody><body><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="j" range="-3 3" {joint}/>
  </body></worldbody><actuator>{actuator}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("joint", "actuator", "torque"),
    [
        ("", '<position joint="j" kp="2000" ctrlrange="-2.9 2.9"/>', None),
        ("", '<position joint="j" kp="2000" ctrlrange="-2.9 2.9" forcerange="-320 300"/>', 300.0),
        ('actuatorfrcrange="-50 50"', '<position joint="j" kp="2000" ctrlrange="-2.9 2.9" forcerange="-320 320"/>', 50.0),
        ("", '<velocity joint="j" kv="10" ctrlrange="-3 3"/>', None),
        ("", '<motor joint="j" gear="100" ctrlrange="-0.5 0.4"/>', 40.0),
        ("", '<general joint="j" gainprm="7" gear="2" ctrlrange="-1 1"/>', 14.0),
        ("", '<general joint="j" gainprm="4500" biastype="affine" biasprm="0 -4500 -450" ctrlrange="-3 3"/>', None),
        ("", '<motor joint="j"/>', None),
    ],
)
def test_only_a_limit_of_force_is_a_limit_of_torque(tmp_path, joint, actuator, torque):
    file = tmp_path / "servo.xml"
    file.write_text(SERVOS.format(joint=joint, actuator=actuator))
    found = load_arm(file).tau_max[0]
    assert np.isnan(found) if torque is None else found == pytest.approx(torque)


def error_text(capsys):
    return " ".join(capsys.readouterr().err.split())


def test_stand_in_masses_are_marked_and_limits_say_where_they_come_from(gripper, tmp_path, capsys):
    command = ["arm", "new", str(gripper), "--tool", "hand", "--limit", "ddq_max=5"]
    assert main([*command, "--numbers", "cad", "--out", str(tmp_path / "cad")]) == 0
    assert "stand-in" not in capsys.readouterr().out
    assert main([*command, "--geometry-only", "--out", str(tmp_path / "bare")]) == 0
    printed = capsys.readouterr().out
    mass = load_arm(tmp_path / "bare").tree.mass[0]
    assert "mass kg (stand-in)" in printed
    assert f"~{mass:.2g} " in printed
    sources = "q_min, q_max, dq_max, tau_max read from grip.urdf; ddq_max given by hand; jerk_max not stated"
    assert f"limits: {sources}" in printed
    assert f'limits = "{sources}"' in (tmp_path / "bare" / "arm.toml").read_text()


def test_a_mistyped_answer_is_asked_again(gripper, tmp_path, capsys, monkeypatch):
    typed = iter(["masured", "measured", "5 rad", "-5", "5", "100,200", "", ""])
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    terminal.readline = lambda: next(typed, "")
    monkeypatch.setattr("sys.stdin", terminal)
    limits = ["--limit", "q_min=-1", "--limit", "q_max=1"]
    assert main(["arm", "new", str(gripper), "--joints", "a,b", "--lock", "f1", *limits, "--out", str(tmp_path / "arm")]) == 0
    arm = load_arm(tmp_path / "arm")
    assert (arm.prior.numbers, arm.ddq_max.tolist(), arm.jerk_max.tolist()) == ("measured", [5.0, 5.0], [100.0, 200.0])
    printed = error_text(capsys)
    assert "'masured' is not one of measured, cad, guessed, unknown; answer again" in printed
    assert "'5 rad' is not one number, or 2 with commas between them; answer again" in printed
    assert "above zero" in printed
    assert printed.count("ddq_max in rad/s^2, one number") == 3


def test_one_joint_is_asked_for_one_number(tmp_path, capsys, monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    assert main(["arm", "drive", "motor", "--out", str(tmp_path / "arm")]) == 0
    assert "dq_max in rad/s, one number; empty to leave it out" in error_text(capsys)
