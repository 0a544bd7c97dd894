"""Exports mean the same to MuJoCo, Pinocchio and ROS's URDF parser, which Pinocchio uses."""

import csv
import json
import math
from dataclasses import replace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.effects import effect_named
from sim.errors import ConfigError
from sim.export import export, parameter_table
from sim.feedforward import friction_table
from sim.resources import shipped_configs
from sim.rigid_body import RigidBody
from sim.urdf import rpy, urdf_text
from tests.sim.inverse_dynamics import inverse_dynamics

ARMS = sorted(p.parent.name for p in shipped_configs().glob("arms/*/arm.toml"))


def motion(n, samples=60):
    rng = np.random.default_rng(5)
    return rng.uniform(-3, 3, (samples, n)), rng.normal(size=(samples, n)) * 2, rng.normal(size=(samples, n)) * 5


def mujoco_torque(path, q, dq, ddq):
    """Inverse dynamics of the rigid bodies alone: no contacts, limits, springs, friction or reflected inertia."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SPRING
    model.dof_damping[:] = 0
    model.dof_armature[:] = 0
    return inverse_dynamics(model, q, dq, ddq)


def pinocchio_torque(model, q, dq, ddq):
    model.armature[:] = 0
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])


@pytest.fixture(scope="module", params=[*ARMS, "changed"])
def exported(request, tmp_path_factory):
    home = tmp_path_factory.mktemp(request.param)
    if request.param in ARMS:
        arm = load_arm(request.param)
    else:
        effects = [
            ArmEffect("base_tilt", None, {"roll": 0.4, "pitch": -0.7}),
            ArmEffect("payload", None, {"mass": 2.3, "com_x": 0.03, "com_y": -0.02, "com_z": 0.09}),
            ArmEffect("joint_spring", "elbow_joint", {"stiffness": 3.0, "rest_angle": 0.5}),
        ]
        inertia = (
            Rotation.from_rotvec([0.3, 0.5, -0.8]).as_matrix()
            @ np.diag([0.1, 0.2, 0.25])
            @ Rotation.from_rotvec([0.3, 0.5, -0.8]).as_matrix().T
        )
        arm = write_arm(
            home / "arm",
            load_arm("ur10e"),
            effects=effects,
            inertials={"wrist_2_joint": (2.1, np.array([0.1, 0.2, -0.3]), inertia)},
        )
    return arm, {p.suffix: p for p in export(arm, home / "out")}


def test_inverse_dynamics_is_the_same_in_every_reader_to_a_nanonewtonmetre(exported):
    arm, files = exported
    q, dq, ddq = motion(6)
    tau = RigidBody(arm).inverse_dynamics(q, dq, ddq)
    assert np.abs(tau).max() > 5
    for result in (
        mujoco_torque(files[".xml"], q, dq, ddq),
        mujoco_torque(files[".urdf"], q, dq, ddq),
        pinocchio_torque(pin.buildModelFromUrdf(str(files[".urdf"])), q, dq, ddq),
    ):
        np.testing.assert_allclose(result, tau, rtol=0, atol=1e-9)


def test_urdf_read_back_is_the_same_arm(exported):
    arm, files = exported
    back = load_arm(files[".urdf"])
    for key in ("mass", "com", "inertia", "position", "rotation", "frictionloss", "damping"):
        if arm.name == "ur10e" and key in ("position", "rotation") and arm.gravity[2] > -9.8:
            continue  # the first frame holds the tilt of the base
        np.testing.assert_allclose(getattr(back.tree, key), getattr(arm.tree, key), rtol=0, atol=1e-14, err_msg=key)
    for key in ("q_min", "q_max", "dq_max", "tau_max"):
        np.testing.assert_array_equal(getattr(back, key), getattr(arm, key))


def test_urdf_names_and_limits_reach_pinocchio(exported):
    arm, files = exported
    model = pin.buildModelFromUrdf(str(files[".urdf"]))
    assert tuple(model.names[1:]) == arm.joint_names
    np.testing.assert_array_equal(model.upperPositionLimit, arm.q_max)
    np.testing.assert_array_equal(model.velocityLimit, arm.dq_max)
    np.testing.assert_array_equal(model.effortLimit, arm.tau_max)


def test_table_has_every_number_and_its_unit(exported):
    arm, files = exported
    rows = list(csv.DictReader(files[".csv"].read_text().splitlines()))
    data = json.loads(files[".json"].read_text())
    assert len(rows) == len(data["parameters"]) >= 6 * 17
    found = {(r["joint"], r["parameter"]): float(r["value"]) for r in rows}
    assert found["elbow_joint", "mass"] == arm.tree.mass[2]
    assert found["elbow_joint", "com_x"] == arm.tree.com[2, 0]
    assert found["elbow_joint", "inertia_yz"] == arm.tree.inertia[2, 1, 2]
    assert (
        found["elbow_joint", "viscous_friction.viscous"] == arm.effect("viscous_friction", "elbow_joint").parameters["viscous"]
    )
    assert all(r["unit"] for r in rows)


def test_standard_deviations_reach_the_table(tmp_path):
    effect = ArmEffect("coulomb_friction", "elbow_joint", {"coulomb": 2.0}, {"coulomb": 0.03})
    arm = write_arm(tmp_path / "arm", load_arm("servo6"), effects=[effect])
    row = next(r for r in parameter_table(arm)["parameters"] if r["std"] is not None)
    assert (row["joint"], row["parameter"], row["value"], row["std"]) == ("elbow_joint", "coulomb_friction.coulomb", 2.0, 0.03)


def test_origin_of_the_inertial_is_the_centre_of_mass_in_the_links_frame(tmp_path):
    """A pendulum with known torque: 2 kg at 0.3 m from a horizontal axis, inertia 0.05 kg m^2 about its centre of mass."""
    (tmp_path / "p.xml").write_text(
        '<mujoco model="p"><worldbody><body name="rod" pos="0 0 1"><joint name="hinge" axis="0 1 0" range="-170 170"/>'
        '<inertial mass="2" pos="0.3 0 0" diaginertia="0.05 0.05 0.05"/></body></worldbody>'
        '<actuator><motor joint="hinge" ctrllimited="true" ctrlrange="-9 9"/></actuator></mujoco>'
    )
    arm = replace(load_arm(tmp_path / "p.xml"), dq_max=np.array([2.0]))
    model = pin.buildModelFromXML(urdf_text(arm))
    standing = pin.rnea(model, model.createData(), np.zeros(1), np.zeros(1), np.zeros(1))
    assert standing[0] == pytest.approx(-2 * 9.81 * 0.3, abs=1e-12)
    turning = pin.rnea(model, model.createData(), np.array([math.pi / 2]), np.zeros(1), np.ones(1))
    assert turning[0] == pytest.approx(0.05 + 2 * 0.3**2, abs=1e-12)


def test_urdf_refuses_what_it_cannot_say(tmp_path):
    arm = load_arm("ur5e")
    with pytest.raises(ConfigError, match=r"gravity of 1\.62 m/s\^2 cannot be written to URDF"):
        urdf_text(replace(arm, tree=replace(arm.tree, gravity=np.array([0, 0, -1.62]))))
    with pytest.raises(ConfigError, match="dq_max of elbow_joint is not given"):
        urdf_text(replace(arm, dq_max=np.where(np.arange(6) == 2, np.nan, arm.dq_max)))
    with pytest.raises(ConfigError, match="no format 'sdf'; known: mjcf, urdf, isaaclab, feedforward, table"):
        export(arm, tmp_path, ["sdf"])


def test_meshes_are_exported_in_place(tmp_path):
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.2, 0), (0, 0, 0.3)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "part.obj").write_text("\n".join(lines))
    (tmp_path / "one.urdf").write_text(
        '<robot name="one"><link name="w"/><link name="l"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        'iyz="0"/></inertial><collision><origin xyz="0.5 0 0" rpy="0.1 0.2 0.3"/><geometry><mesh filename="part.obj"/></geometry>'
        '</collision></link><joint name="j" type="revolute"><parent link="w"/><child link="l"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="5" velocity="2"/></joint></robot>'
    )
    arm = load_arm(tmp_path / "one.urdf")
    export(arm, tmp_path / "out")
    back = load_arm(tmp_path / "out" / "one.urdf")

    def points(a):
        shape = a.tree.shapes[0]
        return np.sort(shape.vertices @ shape.rotation.T + shape.position, axis=0)

    np.testing.assert_allclose(points(back), points(arm), atol=1e-7)
    true = np.array(corners) @ Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix().T + [0.5, 0, 0]
    np.testing.assert_allclose(points(back), np.sort(true, axis=0), atol=1e-7)


@pytest.mark.parametrize("pitch", [0.3, math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9])
def test_roll_pitch_yaw_give_the_rotation_back(pitch):
    turn = Rotation.from_euler("xyz", [0.4, pitch, -1.1]).as_matrix()
    r, p, y = rpy(turn)

    def axis(a, k):
        return Rotation.from_rotvec(a * np.eye(3)[k]).as_matrix()

    np.testing.assert_allclose(axis(y, 2) @ axis(p, 1) @ axis(r, 0), turn, atol=2e-15 if abs(pitch) < 1 else 1e-12)


def test_a_controller_gets_friction_payload_and_gravity(tmp_path):
    effects = [
        ArmEffect("payload", None, {"mass": 2.0, "com_x": 0.01, "com_y": 0.02, "com_z": 0.08}),
        ArmEffect("stribeck_friction", "elbow_joint", {"stiction_excess": 3.0, "stribeck_velocity": 0.1}),
        ArmEffect("base_tilt", None, {"roll": 0.1, "pitch": 0.0}),
    ]
    arm = write_arm(tmp_path / "arm", load_arm("ur10e"), effects=effects)
    files = {p.name: p for p in export(arm, tmp_path / "out")}
    payload = json.loads(files["ur10e_payload.json"].read_text())
    assert payload["payload"]["mass"] == 2.0
    assert payload["urscript"][0] == "set_target_payload(2.0, [0.01, 0.02, 0.08], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0])"
    np.testing.assert_allclose(payload["gravity"], 9.81 * np.array([0, -np.sin(0.1), -np.cos(0.1)]))
    rows = [r for r in csv.DictReader(files["ur10e_friction.csv"].read_text().splitlines()) if r["joint"] == "elbow_joint"]
    curve = {float(r["speed"]): float(r["torque"]) for r in rows if r["speed"] not in ("0.0", "-0.0")}
    own = {e.effect: e.parameters for e in arm.effects if e.joint == "elbow_joint"}
    for speed, torque in curve.items():
        law = (
            own["coulomb_friction"]["coulomb"]
            + 3.0 * np.exp(-((speed / 0.1) ** 2))
            + own["viscous_friction"]["viscous"] * abs(speed)
        )
        assert torque == pytest.approx(np.sign(speed) * law)
    assert [float(r["torque"]) for r in rows if r["speed"] in ("0.0", "-0.0")] == pytest.approx([-12.5, 12.5])
    isaac = json.loads(files["ur10e_isaaclab.json"].read_text())
    assert isaac["actuator"]["friction"]["elbow_joint"] == 12.5
    assert isaac["actuator"]["dynamic_friction"]["elbow_joint"] == 9.5
    assert isaac["actuator"]["armature"]["elbow_joint"] == 3.2
    assert isaac["left_out"] == []


def test_the_friction_table_holds_a_fitted_law_as_it_is_in_steady_motion():
    """The law has memory: after long travel in one direction every slip element is fully built up, whatever its width."""
    terms = {"slip_1e-4": 0.5, "slip_1e-1": 0.7, "power_1": 0.2, "stribeck_0.1": 0.4, "load": 9.0}
    law = effect_named("friction_law")
    values = {p.name: 0.0 for p in law.parameters} | terms
    arm = load_arm("ur10e")
    own = [e for e in arm.effects if e.joint != "elbow_joint"]
    rows = [r for r in friction_table(replace(arm, effects=(*own, ArmEffect("friction_law", "elbow_joint", values))))
            if r["joint"] == "elbow_joint"]  # fmt: skip
    assert len({r["speed"] for r in rows}) == 41
    for row in rows:
        way, speed = math.copysign(1.0, row["speed"]), abs(row["speed"])
        assert row["torque"] == pytest.approx(way * (1.2 + 0.2 * speed + 0.4 * math.exp(-speed / 0.1)), rel=1e-6)


def test_the_urdf_holds_rotors_and_the_interfaces_of_ros2_control(tmp_path):
    arm = load_arm("ur10e")
    text = urdf_text(arm)
    root = ElementTree.fromstring(text)
    rotors = [float(e.get("value")) for e in root.iter("{http://drake.mit.edu}rotor_inertia")]
    np.testing.assert_array_equal(rotors, arm.tree.armature)
    control = root.find("ros2_control")
    assert [j.get("name") for j in control.findall("joint")] == list(arm.joint_names)
    assert control.findtext("hardware/plugin") == "mock_components/GenericSystem"
