"""Linear axes and axes that hardly move: a low speed in m/s is not mistaken for a wrong clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.known_truth import recorded
from calib.gate import gate
from sim.arm import Arm, load_arm
from sim.trajectory import Trajectory

AXIS = """<body name="{0}"><joint name="{0}" type="slide" axis="{1}" range="-1 1" damping="{2}" frictionloss="{3}" armature="3"/>
 <inertial pos="0 0 0" mass="{4}" diaginertia="1 1 1"/>"""
MODEL = (
    '<mujoco model="gantry"><compiler angle="radian" inertiafromgeom="false"/><worldbody>'
    + AXIS.format("x", "1 0 0", 60, 25, 40)
    + AXIS.format("y", "0 1 0", 40, 15, 15)
    + AXIS.format("z", "0 0 1", 30, 10, 6)
    + "</body></body></body></worldbody></mujoco>"
)
ARM = """schema = "arm/1"
name = "gantry"
model = "model.xml"
joints = ["x", "y", "z"]
[limits]
q_min = [-1.0, -1.0, -1.0]
q_max = [1.0, 1.0, 1.0]
dq_max = [1.0, 1.0, 1.0]
ddq_max = [5.0, 5.0, 5.0]
jerk_max = [100.0, 100.0, 100.0]
tau_max = [400.0, 300.0, 200.0]
[sensors]
rate = 200.0
encoder_resolution = 1e-6
velocity_noise = [1e-4, 1e-4, 1e-4]
torque_noise = [1.0, 1.0, 1.0]
[provenance]
all = "made for the tests of the gate"
"""


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    folder = tmp_path_factory.mktemp("gantry")
    (folder / "model.xml").write_text(MODEL)
    (folder / "arm.toml").write_text(ARM)
    return load_arm(Path(folder))


def motion(fastest: float, seed: int) -> Trajectory:
    """Five harmonics in 20 s on each axis, with a peak speed of `fastest` m/s."""
    t, w = np.arange(0.0, 20.0, 0.01), 2 * np.pi * np.arange(1, 6) / 20.0
    a, b = np.random.default_rng(seed).standard_normal((2, 5, 3))
    sin, cos = np.sin(t[:, None] * w), np.cos(t[:, None] * w)
    q, dq, ddq = (
        sin @ (a / w[:, None]) - cos @ (b / w[:, None]),
        cos @ a + sin @ b,
        cos @ (b * w[:, None]) - sin @ (a * w[:, None]),
    )
    by = fastest / np.abs(dq).max(axis=0)
    return Trajectory(t, by * q, by * dq, by * ddq)


@pytest.mark.parametrize("fastest", [0.002, 0.0105, 0.011, 0.012, 0.013, 0.016, 0.02, 0.03, 0.1])
def test_a_slow_slide_is_no_other_clock_and_no_other_column(gantry: Arm, fastest: float) -> None:
    """Just above 0.01 m/s only the peaks counted as motion, and some shift or exchange explained their noise."""
    for seed in range(8):
        assert gate(gantry, [recorded(gantry, motion(fastest, seed), seed)]).refusal is None


def test_another_clock_of_a_slide_that_moves_is_found(gantry: Arm) -> None:
    log = recorded(gantry, motion(0.05, 0), 0)
    found = gate(gantry, [replace(log, tau=np.roll(log.tau, 100, axis=0))])
    assert found.refusal is not None
    assert "another clock" in found.causes[0].sentence
