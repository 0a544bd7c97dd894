"""The torque constant of a drive on a bench, from the gravity of its load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.identification.base_fit import Options
from calib.identification.loaded import identify_with_own_load
from logs.log import Log
from sim.arm import Arm
from sim.errors import AnswerIsNo, ConfigError
from sim.new_arm import drive_arm
from sim.rigid_body import RigidBody

MASS, LEVER, CONSTANT = 0.49, 0.1, 0.42
LIMITS = {"dq_max": 6.0, "ddq_max": 60.0, "jerk_max": 600.0, "tau_max": 2.0, "q_min": -3.0, "q_max": 3.0}


def pendulum(folder: Path) -> Arm:
    arm = drive_arm("bench", "joint1", (MASS, LEVER), False, folder)
    return replace(arm, **{name: np.array([value]) for name, value in LIMITS.items()})


def recording(arm: Arm, seed: int, reach: float = 1.2, mass: float = MASS) -> Log:
    """Currents of a motion of up to `reach` rad, with viscous and Coulomb friction that the arm's file does not state."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.004)
    w = 2 * np.pi * np.array([0.31, 0.73, 1.1])
    size, phase = reach * np.array([0.6, 0.25, 0.15]), rng.uniform(0, 2 * np.pi, 3)
    q = np.sin(np.outer(t, w) + phase) @ size
    dq = (np.cos(np.outer(t, w) + phase) * w) @ size
    ddq = -(np.sin(np.outer(t, w) + phase) * w**2) @ size
    tau = RigidBody(arm).inverse_dynamics(q[:, None], dq[:, None], ddq[:, None]) * mass / MASS
    tau[:, 0] += 0.02 * dq + 0.03 * np.tanh(dq / 0.01)
    current = tau / CONSTANT + 0.01 * rng.standard_normal(tau.shape)
    nan = np.full(tau.shape, np.nan)
    return Log(arm.joint_names, t, t, q[:, None], dq[:, None], nan, current, nan, nan, nan, nan)


def test_the_constant_comes_from_gravity_and_friction_has_no_part_in_it(tmp_path: Path) -> None:
    arm = pendulum(tmp_path)
    found = identify_with_own_load(arm, [recording(arm, 1), recording(arm, 2)], [], Options(), MASS)
    assert found.arm.torque_constant == pytest.approx([CONSTANT], rel=0.02)
    assert "from the gravity of its own 0.49 kg" in found.arm.provenance["torque_constant"]
    assert any("torque constant is 0.4" in sentence for sentence in found.result.findings)
    coulomb = found.arm.effect("coulomb_friction", "joint1")
    assert coulomb is not None
    assert coulomb.parameters["coulomb"] == pytest.approx(0.03, rel=0.15)


def test_another_mass_than_the_files_scales_the_constant(tmp_path: Path) -> None:
    arm = pendulum(tmp_path)
    found = identify_with_own_load(arm, [recording(arm, 1, mass=2 * MASS)], [], Options(), 2 * MASS)
    assert found.arm.torque_constant == pytest.approx([CONSTANT], rel=0.03)


def test_a_motion_that_does_not_lift_the_load_determines_nothing(tmp_path: Path) -> None:
    arm = pendulum(tmp_path)
    with pytest.raises(AnswerIsNo, match="record a motion that lifts the load"):
        identify_with_own_load(arm, [recording(arm, 1, reach=0.01)], [], Options(), MASS)


def test_a_motion_that_hardly_lifts_it_gives_a_wide_interval_that_covers(tmp_path: Path) -> None:
    arm = pendulum(tmp_path)
    found = identify_with_own_load(arm, [recording(arm, 1, reach=0.02)], [], Options(), MASS)
    constant, std = found.arm.torque_constant[0], float(found.arm.provenance["torque_constant"].split("std ")[1].split()[0])
    assert 0.05 * CONSTANT < std < 0.25 * CONSTANT
    assert abs(constant - CONSTANT) < 2 * std


def test_what_cannot_have_a_constant_is_refused_with_its_reason(tmp_path: Path, ur5e: Arm) -> None:
    arm = pendulum(tmp_path)
    log = recording(arm, 1)
    with pytest.raises(ConfigError, match="has 6 joints, so it needs recordings with that load"):
        identify_with_own_load(ur5e, [log], [], Options(), MASS)
    with pytest.raises(ConfigError, match="hold torque"):
        identify_with_own_load(arm, [replace(log, tau=np.ones(log.q.shape))], [], Options(), MASS)
