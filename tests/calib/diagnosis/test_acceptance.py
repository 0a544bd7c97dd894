"""Evidence that an effect needs to be named: on its own, beside other effects and against held-out recordings."""

from __future__ import annotations

from dataclasses import replace

from calib.diagnosis.acceptance import (
    APART,
    LEAST,
    LEAST_EVENT,
    LEAST_STATED,
    SECOND,
    SECOND_ALONE,
    Assessed,
    joints_of_other_form,
    strongest_beside,
)
from calib.diagnosis.prices import price
from sim.arm import ArmEffect


def assessed(lost: float, *rivals: tuple[str, str | None]) -> Assessed:
    return Assessed(ArmEffect("torque_offset", "elbow_joint", {"offset": 2.0}), lost, rivals, held_out=5.0)


def test_weak_evidence_is_no_name() -> None:
    least = price(assessed(0.0).effect) + LEAST - assessed(0.0).held_out
    assert assessed(least - 1.0).doubtful
    assert not assessed(least + 1.0).doubtful
    assert not assessed(least + 1.0, ("asymmetric_friction", "elbow_joint")).doubtful


def test_an_effect_beside_one_with_an_exact_law_is_not_measured_by_it() -> None:
    """A constant offset has an exact law, so no second effect can come from its form. Friction has no exact law."""
    pairs = [("torque_offset", "a"), ("viscous_friction", "a"), ("encoder_offset", "a"), ("stribeck_friction", "b")]
    accepted = [ArmEffect(effect, joint, {}) for effect, joint in pairs]
    assert strongest_beside(accepted, [900.0, 50.0, 30.0, 80.0], ("a", "b")) == [50.0, 0.0, 50.0, 0.0]


def test_a_joint_with_a_stronger_effect_of_another_form_says_nothing_of_the_whole_arm() -> None:
    pairs = [("time_delay", None), ("backlash", "a"), ("torque_offset", "b"), ("link_inertia", "a"), ("stribeck_friction", "b")]
    accepted = [ArmEffect(effect, joint, {}) for effect, joint in pairs]
    lost = [200.0, 500.0, 900.0, 100.0, 150.0]
    silent = [joints_of_other_form(accepted, lost, i, ("a", "b")).tolist() for i in range(len(accepted))]
    # The offset's law is exact, and Stribeck friction is weaker than the delay. `strongest_beside` covers a link's own joint.
    assert silent == [[True, False], [False, False], [False, False], [False, True], [False, False]]


def test_friction_and_rotors_need_less_beyond_their_price() -> None:
    """Their spread is stated, so the size of a deviation is evidence in itself."""
    item = ArmEffect("rotor_inertia", "elbow_joint", {"inertia": 2.0})
    assert Assessed(item, price(item) + LEAST_STATED - 1.0, (), 0.0).doubtful
    assert Assessed(item, price(item) + LEAST_STATED - 1.0, (), 20.0).doubtful  # held-out recordings alone are not enough
    assert not Assessed(item, price(item) + LEAST_STATED + 1.0, (), 0.0).doubtful
    assert LEAST_STATED < LEAST


def test_a_push_needs_less_because_no_held_out_recording_holds_it() -> None:
    push = ArmEffect("external_contact", None, {"start": 1.0, "duration": 1.0, "force_x": 3.0, "force_y": 0.0, "force_z": 0.0})
    assert Assessed(push, price(push) + LEAST_EVENT - 1.0, (), 0.0).doubtful
    assert not Assessed(push, price(push) + LEAST_EVENT + 1.0, (), 0.0).doubtful
    assert LEAST_EVENT < LEAST


def test_a_small_second_name_at_a_joint_is_no_name() -> None:
    rival = ("asymmetric_friction", "elbow_joint")
    clear = price(assessed(0.0).effect) + APART + 40.0
    assert replace(assessed(clear, rival), first=clear / SECOND + 1.0).doubtful
    assert not replace(assessed(clear, rival), first=clear / SECOND - 1.0).doubtful
    assert replace(assessed(clear), first=clear / SECOND_ALONE + 1.0).doubtful
    assert not replace(assessed(clear), first=clear / SECOND_ALONE - 1.0).doubtful
