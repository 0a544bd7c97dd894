"""The error of the flange is that of its site, wherever the last joint lies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.measurement.preprocessing import prepare
from calib.validation.forward import forward_error
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

TWO = """<mujoco model="two"><compiler angle="radian"/><worldbody><body name="a">
  <joint name="first" axis="0 1 0" range="-3 3"/><inertial mass="2" pos="0 0 0.15" diaginertia="0.02 0.02 0.01"/>
  <body name="b" pos="0 0 0.3"><joint name="second" axis="0 1 0" range="-3 3"/>
  <inertial mass="1" pos="0 0 0.1" diaginertia="0.01 0.01 0.005"/>{site}</body></body></worldbody>
  <actuator><motor joint="first"/><motor joint="second"/></actuator></mujoco>"""


def arm(folder: Path, site: str) -> Arm:
    file = folder / "two.xml"
    file.write_text(TWO.format(site=site))
    return replace(load_arm(file), dq_max=np.full(2, 4.0))


def recording(of: Arm) -> Log:
    t = np.arange(0.0, 8.0, 0.005)
    rate = 2 * np.pi * np.array([0.4, 0.6])
    angle = t[:, None] * rate + [0.3, 1.0]
    q, dq, ddq = 0.6 * np.sin(angle), 0.6 * rate * np.cos(angle), -0.6 * rate**2 * np.sin(angle)
    nan = np.full(q.shape, np.nan)
    return Log(of.joint_names, t, t, q, dq, predict(of, Trajectory(t, q, dq, ddq)), nan, nan, nan, nan, nan)


def test_a_joint_before_the_flange_moves_it(tmp_path: Path) -> None:
    with_site = arm(tmp_path, '<site name="attachment_site" pos="0 0 0.4"/>')
    log = recording(with_site)
    rubbing = with_effect(with_site, ArmEffect("viscous_friction", "second", {"viscous": 0.05}))
    found = forward_error(rubbing, prepare(log, rubbing))
    without = forward_error(
        with_effect(arm(tmp_path, ""), ArmEffect("viscous_friction", "second", {"viscous": 0.05})), prepare(log, rubbing)
    )
    np.testing.assert_allclose(found.angle, without.angle, rtol=1e-6)
    assert found.angle[1] > 3 * found.angle[0]
    # all links turn about parallel axes: the site is 0.4 m from the second axis, the last link's origin on it
    assert found.flange == pytest.approx(0.4 * found.angle[1], rel=0.5)
    assert without.flange < 0.5 * found.flange
