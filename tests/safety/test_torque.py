"""Friction that an arm states is expected, with its doubt; friction that is not stated is not assumed to be zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety.clear import clear
from safety.parameters import SIGMAS, friction_of
from safety.torque import WARMING, check_torque, largest_rms, torque_interval
from sim.arm import Arm, ArmEffect
from sim.cell import Cell
from sim.effects import with_effect
from sim.errors import SafetyStop
from sim.prior import FRICTION_SHARE
from tests.safety.conftest import sine


def test_an_arm_that_states_that_it_has_no_friction_is_expected_to_have_none(arm: Arm) -> None:
    friction = friction_of(arm)
    for name in ("coulomb", "coulomb_doubt", "viscous", "viscous_doubt"):
        np.testing.assert_allclose(getattr(friction, name), np.zeros(arm.n), atol=1e-8)


def test_friction_and_rotor_that_nobody_stated_may_be_as_large_as_in_an_ordinary_drive(arm: Arm) -> None:
    friction = friction_of(replace(arm, effects=()))
    np.testing.assert_allclose(friction.coulomb_doubt, SIGMAS * FRICTION_SHARE * arm.tau_max)
    np.testing.assert_allclose(friction.viscous_doubt * arm.dq_max, SIGMAS * FRICTION_SHARE * arm.tau_max)
    np.testing.assert_allclose(friction.inertia_doubt * arm.ddq_max, arm.tau_max)


def test_what_the_prior_lists_as_unknown_is_not_certain_because_the_model_has_a_number(arm: Arm) -> None:
    stated = with_effect(arm, ArmEffect("coulomb_friction", "j3", {"coulomb": 5.0}))
    unknown = replace(stated, prior=stated.prior.model_copy(update={"unknown": ["coulomb"]}))
    assert friction_of(unknown).coulomb_doubt[2] == pytest.approx(SIGMAS * FRICTION_SHARE * arm.tau_max[2])


@pytest.mark.parametrize(
    ("effect", "key", "word"),
    [
        ("coulomb_friction", "coulomb", "dry friction"), ("viscous_friction", "viscous", "viscous friction"),
        ("rotor_inertia", "rotor", "reflected inertia"),
    ],
)  # fmt: skip
def test_a_motion_that_an_unknown_could_make_too_heavy_is_refused_and_the_unknown_is_named(
    arm: Arm, cell: Cell, effect: str, key: str, word: str
) -> None:
    motion = sine(amplitude=0.2, duration=3.0, step=0.002)
    clear(motion, arm, cell)
    # torque limits that just suffice for what is known of the arm
    known = torque_interval(motion, arm, cell)
    tight = replace(arm, tau_max=1.01 * (np.abs(known.tau_hat) + known.doubt).max(axis=0) + 0.05)
    check_torque(motion, torque_interval(motion, tight, cell), tight)
    without = replace(tight, effects=tuple(e for e in tight.effects if e.effect != effect))
    listed = replace(tight, prior=tight.prior.model_copy(update={"unknown": [key]}))
    for unknown in (without, listed):
        with pytest.raises(SafetyStop, match=f"No values are stated for {word} of j"):
            check_torque(motion, torque_interval(motion, unknown, cell), unknown)
        with pytest.raises(SafetyStop):
            clear(motion, unknown, cell)


def test_no_fact_is_called_missing_where_all_are_stated(arm: Arm, cell: Cell) -> None:
    motion = sine(amplitude=0.2, duration=3.0, step=0.002)
    weak = replace(arm, tau_max=np.full(arm.n, 1.0), prior=arm.prior)
    with pytest.raises(SafetyStop) as refused:
        check_torque(motion, torque_interval(motion, weak, cell), weak)
    assert "No values are stated for" not in str(refused.value)


def test_what_was_fitted_is_doubted_by_its_own_deviation_and_what_was_not_by_the_prior(arm: Arm) -> None:
    fitted = ArmEffect("coulomb_friction", "j2", {"coulomb": 10.0}, {"coulomb": 0.3})
    stated = ArmEffect("coulomb_friction", "j3", {"coulomb": 5.0})
    friction = friction_of(with_effect(with_effect(arm, fitted), stated))
    np.testing.assert_array_equal(friction.coulomb, [0, 10.0, 5.0, 0, 0, 0])
    np.testing.assert_allclose(friction.coulomb_doubt, [0, SIGMAS * 0.3, SIGMAS * arm.prior.coulomb * 5.0, 0, 0, 0], atol=1e-8)


def test_rms_torque_counts_only_where_it_lasts(arm: Arm, cell: Cell) -> None:
    """Peaks above the continuous torque are allowed; an RMS torque above it is refused."""
    short, long = sine(amplitude=0.2, duration=3.0, step=0.002), sine(amplitude=0.2, duration=60.0, step=0.01)
    torque = torque_interval(long, arm, cell)
    used = check_torque(long, torque, arm)
    assert 0 < used["rms torque"] <= used["tau"]  # relative to tau_max if no continuous torque is stated
    worst = np.abs(torque.tau_hat) + torque.doubt
    held = np.sqrt((worst**2).mean(axis=0))
    fits = replace(arm, torque_continuous=np.maximum(1.1 * held, 5.0))
    assert check_torque(long, torque, fits)["rms torque"] == pytest.approx(1 / 1.1, abs=0.08)
    with pytest.raises(SafetyStop, match=r"RMS torque up to .* over 30 s exceeds the .* can hold indefinitely"):
        check_torque(long, torque, replace(arm, torque_continuous=np.maximum(0.9 * held, 5.0)))
    with pytest.raises(SafetyStop, match="RMS torque"):
        clear(short, replace(arm, torque_continuous=np.full(arm.n, 0.5)), cell)


def test_rms_torque_is_the_largest_of_any_window(arm: Arm, cell: Cell) -> None:
    t = np.linspace(0, 120.0, 12001)
    torque = np.where((t >= 40) & (t < 40 + WARMING), 10.0, 1.0)[:, None]
    assert largest_rms(t, torque)[0] == pytest.approx(10.0, rel=1e-3)
    assert largest_rms(t[:1501], torque[:1501])[0] == pytest.approx(1.0)
    short_peak = np.where((t >= 40) & (t < 43), 10.0, 0.0)[:, None]
    assert largest_rms(t, short_peak)[0] == pytest.approx(10 * np.sqrt(3 / WARMING), rel=2e-3)


def test_rms_torque_that_is_not_a_number_is_refused(arm: Arm, cell: Cell) -> None:
    motion = sine(amplitude=0.2, duration=3.0, step=0.002)
    with pytest.raises(SafetyStop, match="RMS torque"):
        check_torque(motion, torque_interval(motion, arm, cell), replace(arm, torque_continuous=np.full(arm.n, np.nan)))
