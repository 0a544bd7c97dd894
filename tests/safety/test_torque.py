"""What an arm states of its friction is expected of it, with its doubt; what it does not state is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from safety.torque import SIGMAS, friction_of
from sim.arm import Arm, ArmEffect


def test_an_arm_that_states_no_friction_is_expected_to_have_none(arm: Arm) -> None:
    friction = friction_of(replace(arm, effects=()))
    for name in ("inertia", "inertia_doubt", "coulomb", "coulomb_doubt", "viscous", "viscous_doubt"):
        np.testing.assert_array_equal(getattr(friction, name), np.zeros(arm.n))


def test_what_was_fitted_is_doubted_by_its_own_deviation_and_what_was_not_by_the_prior(arm: Arm) -> None:
    fitted = ArmEffect("coulomb_friction", "j2", {"coulomb": 10.0}, {"coulomb": 0.3})
    stated = ArmEffect("coulomb_friction", "j3", {"coulomb": 5.0})
    friction = friction_of(replace(arm, effects=(fitted, stated)))
    np.testing.assert_array_equal(friction.coulomb, [0, 10.0, 5.0, 0, 0, 0])
    np.testing.assert_allclose(friction.coulomb_doubt, [0, SIGMAS * 0.3, SIGMAS * arm.prior.coulomb * 5.0, 0, 0, 0])
