"""The contract of every shipped arm: it loads, its numbers are physical, and ordinary poses are free of self-contact."""

import math

import mujoco
import numpy as np
import pytest

from sim.arm import load_arm
from sim.resources import shipped_configs
from sim.rigid_body import RigidBody

ARMS = sorted(p.parent.name for p in shipped_configs().glob("arms/*/arm.toml"))
HALF = math.pi / 2
POSES = {
    "zero": (0, 0, 0, 0, 0, 0),
    "home": (0, -HALF, 0, -HALF, 0, 0),
    "work": (0, -HALF, HALF, -HALF, -HALF, 0),
    "folded": (0, -2.6, 2.6, -HALF, -HALF, 0),
}


@pytest.fixture(scope="module", params=ARMS)
def arm(request):
    return load_arm(request.param)


class SelfContact:
    def __init__(self, arm):
        self.model = mujoco.MjModel.from_xml_string(arm.model_text)
        self.data = mujoco.MjData(self.model)

    def __call__(self, q):
        self.data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return [(self.model.geom(c.geom1).name, self.model.geom(c.geom2).name) for c in self.data.contact if c.dist < 0]


def test_the_whole_family_is_there():
    family = "ur3 ur5 ur10 ur3e ur5e ur7e ur10e ur12e ur16e ur15 ur18 ur20 ur30 ur8l"
    assert sorted(family.split()) == [name for name in ARMS if name != "servo6"]


def test_nothing_is_missing_and_everything_has_a_source(arm):
    assert arm.incomplete == ()
    for key in ("q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max"):
        assert np.all(np.isfinite(getattr(arm, key)))
    sources = " ".join(arm.provenance)
    for subject in (
        "kinematics",
        "mass",
        "inertia",
        "tau_max",
        "dq_max",
        "q_min",
        "ddq_max",
        "jerk_max",
        "coulomb",
        "sensors",
        "capsules",
    ):
        assert subject in sources
    assert "not published" in arm.provenance["jerk_max"]
    assert (arm.torque_constant is not None) == ("torque_constant" in arm.provenance)


def test_joints_and_links_have_the_names_of_ur_description(arm):
    assert arm.joint_names == (
        "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
    )  # fmt: skip
    assert arm.tree.link_names[1:3] == ("upper_arm_link", "forearm_link")


def test_every_inertia_is_that_of_a_body(arm):
    for mass, inertia in zip(arm.tree.mass, arm.tree.inertia, strict=True):
        small, middle, large = np.linalg.eigvalsh(inertia)
        assert mass > 0
        assert small > 0
        assert large <= small + middle


def test_motors_have_the_published_torque_and_can_hold_the_arm(arm):
    np.testing.assert_array_equal(arm.tree.tau_max, arm.tau_max)
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (500, 6))
    share = np.abs(RigidBody(arm).gravity_torque(q)).max(axis=0) / arm.tau_max
    assert np.all(share < 0.7)
    assert share[1] > 0.1


@pytest.mark.parametrize("pose", POSES)
def test_ordinary_poses_are_free_of_self_contact(arm, pose):
    # the UR18's forearm is so short that its wrist, at the size estimated here, touches the upper arm when folded that far
    q = (0, -2.3, 2.3, -HALF, -HALF, 0) if (arm.name, pose) == ("ur18", "folded") else POSES[pose]
    assert SelfContact(arm)(q) == []


def test_shapes_are_close_enough_to_be_useful(arm):
    contact = SelfContact(arm)
    rng = np.random.default_rng(0)
    flagged = np.mean([bool(contact(q)) for q in rng.uniform(-math.pi, math.pi, (1000, 6))])
    assert 0.1 < flagged < 0.4
    assert {s.link for s in arm.tree.shapes} == set(range(-1, 6))


def test_a_fully_bent_elbow_is_a_contact(arm):
    assert SelfContact(arm)((0, -HALF, math.pi, 0, 0, 0))


@pytest.mark.parametrize(
    ("name", "reach"),
    [
        ("ur3e", 0.5),
        ("ur5e", 0.85),
        ("ur7e", 0.85),
        ("ur10e", 1.3),
        ("ur12e", 1.3),
        ("ur16e", 0.9),
        ("ur20", 1.75),
        ("ur30", 1.3),
        ("ur15", 1.3),
        ("ur8l", 1.75),
        ("ur3", 0.5),
        ("ur5", 0.85),
        ("ur10", 1.3),
    ],
)
def test_reach_is_the_published_one(name, reach):
    # data sheets give the rounded reach to the centre of the wrist; the UR30's kinematics give 0.89 of its 1.3 m
    arm = load_arm(name)
    model = mujoco.MjModel.from_xml_string(arm.model_text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    a = np.hypot(*data.body("wrist_2_link").xpos[:2])
    assert reach * 0.88 < a < reach * 1.05
