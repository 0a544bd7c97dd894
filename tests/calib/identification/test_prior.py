"""Friction that an arm file lists as unknown, or gives no number for, is free in every prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.identification.model import TorqueModel
from calib.identification.prior import nominal_prior
from sim.arm import Arm, load_arm
from sim.prior import FRICTION_SHARE, torque_scale


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur5e")


def deviations(arm: Arm, kind: str) -> np.ndarray:
    """Standard deviations (n,) of a kind of parameter before any data."""
    model = TorqueModel.of_arm(arm)
    covariance = np.linalg.inv(nominal_prior(arm, model).precision)
    return np.sqrt([covariance[k, k] for k in (model.friction_column(kind, j) for j in range(arm.n))])


def unknown(arm: Arm, *kinds: str) -> Arm:
    return replace(arm, prior=arm.prior.model_copy(update={"unknown": frozenset(kinds)}))


def test_stated_friction_is_known_as_well_as_the_file_says(arm: Arm) -> None:
    level = np.array([arm.effect("coulomb_friction", j).parameters["coulomb"] for j in arm.joint_names])
    np.testing.assert_allclose(deviations(arm, "coulomb"), arm.prior.coulomb * level)


def test_unknown_friction_is_free_whatever_number_stands_in_the_file(arm: Arm) -> None:
    wide = FRICTION_SHARE * torque_scale(arm)
    np.testing.assert_allclose(deviations(unknown(arm, "coulomb"), "coulomb"), wide)
    np.testing.assert_allclose(deviations(unknown(arm, "viscous"), "viscous"), wide / arm.dq_max)
    np.testing.assert_allclose(deviations(unknown(arm, "coulomb"), "viscous"), deviations(arm, "viscous"))
    assert np.all(deviations(unknown(arm, "coulomb"), "coulomb") > deviations(arm, "coulomb"))


def test_an_arm_without_friction_in_its_file_states_none(arm: Arm) -> None:
    """Formerly its std was a share of zero, so friction absent from the file was certain to be zero."""
    bare = replace(arm, effects=())
    np.testing.assert_allclose(deviations(bare, "coulomb"), FRICTION_SHARE * torque_scale(arm))


def test_an_offset_is_small_unless_it_is_unknown(arm: Arm) -> None:
    level = np.array([arm.effect("coulomb_friction", j).parameters["coulomb"] for j in arm.joint_names])
    np.testing.assert_allclose(deviations(arm, "offset"), 0.1 * level)
    np.testing.assert_allclose(deviations(unknown(arm, "offset"), "offset"), FRICTION_SHARE * torque_scale(arm))
