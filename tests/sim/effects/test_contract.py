"""The contract of every effect of the catalogue: name, parameters, bounds, where it acts, and no change at zero strength."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sim.effects
from sim.arm import Arm, ArmEffect
from sim.arm_folder import write_arm
from sim.effects import EFFECTS, LAWS, Effect, Stage, checked, effect_named, with_effect
from sim.errors import ConfigError
from sim.prediction import predict, torque_path
from sim.trajectory import Trajectory

# The contract with readers of diagnosis.json: name -> (scope, parameter -> unit). Names never change.
PUBLIC = {
    "coulomb_friction": ("joint", {"coulomb": "N*m"}),
    "viscous_friction": ("joint", {"viscous": "N*m*s/rad"}),
    "asymmetric_friction": ("joint", {"half_difference": "N*m"}),
    "stribeck_friction": ("joint", {"stiction_excess": "N*m", "stribeck_velocity": "rad/s"}),
    "nonlinear_viscous_friction": ("joint", {"coefficient": "N*m*(s/rad)^exponent", "exponent": "1"}),
    "load_dependent_friction": ("joint", {"coefficient": "1"}),
    "thermal_friction": ("joint", {"relative_drop": "1", "time_constant": "s"}),
    "presliding_friction": ("joint", {"stiffness": "N*m/rad"}),
    "rotor_inertia": ("joint", {"inertia": "kg*m^2"}),
    "joint_elasticity": ("joint", {"stiffness": "N*m/rad"}),
    "backlash": ("joint", {"half_gap": "rad"}),
    "torque_ripple": ("joint", {"amplitude": "N*m", "cycles": "1/rev", "phase": "rad"}),
    "joint_spring": ("joint", {"stiffness": "N*m/rad", "rest_angle": "rad"}),
    "torque_gain": ("joint", {"gain": "1"}),
    "torque_offset": ("joint", {"offset": "N*m"}),
    "torque_saturation": ("joint", {"limit": "N*m"}),
    "encoder_offset": ("joint", {"offset": "rad"}),
    "encoder_eccentricity": ("joint", {"amplitude": "rad", "cycles": "1/rev", "phase": "rad"}),
    "time_delay": ("arm", {"delay": "s"}),
    "payload": ("arm", {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"}),
    "link_inertia": ("joint", {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"}),
    "base_tilt": ("arm", {"roll": "rad", "pitch": "rad"}),
    "tool_force": ("arm", {"force_x": "N", "force_y": "N", "force_z": "N"}),
    "transmission_coupling": ("joint", {"ratio": "1", "inertia": "kg*m^2", "viscous": "N*m*s/rad", "coulomb": "N*m"}),
    "external_contact": ("arm", {"start": "s", "duration": "s", "force_x": "N", "force_y": "N", "force_z": "N"}),
}
BODIES = ("link_inertia",)  # never absent: a link has a mass

every_effect = pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
Present = Callable[[Effect], ArmEffect]


def absent(arm: Arm, effect: Effect, joint: str | None) -> ArmEffect:
    """The effect at zero strength: for BODIES, the link's own mass and centre of mass."""
    values = effect.none()
    if effect.name in BODIES and joint is not None:
        j = arm.joint_index(joint)
        values = dict(zip(values, (arm.tree.mass[j], *arm.tree.com[j]), strict=True))
    return ArmEffect(effect.name, joint, values)


def test_the_catalogue_is_the_public_one() -> None:
    assert {e.name: (e.scope, {p.name: p.unit for p in e.parameters}) for e in EFFECTS} == PUBLIC
    assert len({e.name for e in EFFECTS}) == len(EFFECTS)


def test_one_file_an_effect() -> None:
    folder = Path(str(sim.effects.__file__)).parent
    assert {f.stem for f in folder.glob("*.py")} - {"__init__", "effect"} == {e.name for e in (*EFFECTS, *LAWS)}
    assert all(type(e).__module__ == f"sim.effects.{e.name}" for e in EFFECTS)


@every_effect
def test_it_says_what_it_is(effect: Effect) -> None:
    for text in (effect.summary, effect.looks, effect.reference, effect.experiment, type(effect).__doc__):
        assert text
        assert text == text.strip()
    assert all(p.meaning and p.unit for p in effect.parameters)
    assert effect_named(effect.name) is effect


@every_effect
def test_its_parameters_lie_within_their_bounds(effect: Effect) -> None:
    for p in effect.parameters:
        assert p.lower < p.upper
        assert p.grid
        assert all(p.lower <= x <= p.upper and math.isfinite(x) for x in p.grid)
        assert p.zero is None or p.lower <= p.zero <= p.upper


@every_effect
def test_bounds_are_kept(effect: Effect, arm: Arm, motion: Trajectory, present: Present) -> None:
    item = present(effect)
    assert checked(arm, item) is item
    for p in effect.parameters:
        for bound, beyond in ((p.lower, -np.inf), (p.upper, np.inf)):
            if math.isfinite(bound):
                at = ArmEffect(item.effect, item.joint, item.parameters | {p.name: bound})
                assert checked(arm, at) is at
                outside = ArmEffect(item.effect, item.joint, item.parameters | {p.name: float(np.nextafter(bound, beyond))})
                with pytest.raises(ConfigError, match=rf"{p.name} = .* must lie between"):
                    checked(arm, outside)
        with pytest.raises(ConfigError, match="must lie between"):
            checked(arm, ArmEffect(item.effect, item.joint, item.parameters | {p.name: math.nan}))
        if len(effect.parameters) > 1:
            with pytest.raises(ConfigError, match="needs exactly"):
                checked(arm, ArmEffect(item.effect, item.joint, {p.name: item.parameters[p.name]}))
    with pytest.raises(ConfigError, match="needs exactly"):
        checked(arm, ArmEffect(item.effect, item.joint, item.parameters | {"colour": 1.0}))
    wrong = None if effect.scope == "joint" else arm.joint_names[0]
    with pytest.raises(ConfigError, match=r"a joint is needed|leave the joint out"):
        checked(arm, ArmEffect(item.effect, wrong, item.parameters))
    first = ArmEffect(item.effect, arm.joint_names[0], item.parameters)
    if effect.driven:
        with pytest.raises(ConfigError, match="the first has none"):
            checked(arm, first)
        # also if an arm file lists it
        with pytest.raises(ConfigError, match="the first has none"):
            predict(replace(arm, effects=(first,)), motion)


@every_effect
def test_without_strength_it_changes_nothing(effect: Effect, arm: Arm, motion: Trajectory, present: Present) -> None:
    item = present(effect)
    bare = replace(arm, effects=tuple(e for e in arm.effects if (e.effect, e.joint) != (item.effect, item.joint)))
    without, strong = predict(bare, motion), predict(with_effect(bare, item), motion)
    weak = predict(with_effect(bare, absent(bare, effect, item.joint)), motion)
    strength = np.abs(strong - without).max()
    assert strength > 1e-3
    # a gear is never rigid: at its stiffest it twists by a thousandth of a typical twist
    gone = 2e-3 * strength if effect.name == "joint_elasticity" else 1e-9 * np.abs(without).max()
    assert np.abs(weak - without).max() <= gone


@every_effect
def test_a_joint_effect_acts_at_its_joint(effect: Effect, arm: Arm, motion: Trajectory, present: Present) -> None:
    item = present(effect)
    change = predict(with_effect(arm, item), motion) - predict(arm, motion)
    reached = set(np.flatnonzero(np.abs(change).max(axis=0) > 1e-9))
    if effect.scope == "arm" or effect.stage in (Stage.ENCODER, Stage.RIGID):
        assert len(reached) > 1
    else:
        j = arm.joint_index(str(item.joint))
        assert reached == ({j - 1, j} if effect.driven else {j})
        passed_on = effect.passed_on(item.parameters)
        assert (passed_on != 0) == effect.driven
        if effect.driven:
            np.testing.assert_allclose(change[:, j - 1], passed_on * change[:, j], atol=1e-9)


@every_effect
def test_its_probes_give_its_torque(effect: Effect, arm: Arm, motion: Trajectory) -> None:
    """`combine` maps each unit coefficient to its point of the probe, and half of the first to half of the torque, to 5 %.

    The half is not required of rigid-body effects, nor of compliances (coefficients of 1/stiffness), linear only if small.
    """
    compliance = effect.none() == {"stiffness": effect.parameters[0].upper}
    joint = arm.joint_names[1] if effect.scope == "joint" else None
    for probe in effect.probes(None):
        for k, point in enumerate(probe.points):
            unit = np.eye(len(probe.points))[k]
            assert probe.combine(unit) == pytest.approx(dict(point), abs=1e-12)
        if compliance or effect.stage is Stage.RIGID or not probe.points:
            continue

        def torque(values: dict[str, float]) -> np.ndarray:
            return torque_path(arm, motion, [*arm.effects, ArmEffect(effect.name, joint, values)]).tau

        zero, whole = torque(dict(probe.base)), torque(dict(probe.points[0]))
        half = torque(probe.combine(np.eye(len(probe.points))[0] * 0.5))
        size = np.sqrt(np.mean((whole - zero) ** 2))
        if size > 1e-6:
            bent = np.sqrt(np.mean((2 * (half - zero) - (whole - zero)) ** 2)) / size
            assert bent < 0.05, probe


@every_effect
def test_an_arm_folder_carries_it(effect: Effect, arm: Arm, motion: Trajectory, present: Present, tmp_path: Path) -> None:
    item = present(effect)
    expected = predict(with_effect(arm, item), motion)
    read_back = write_arm(tmp_path / "arm", arm, effects=[item])
    np.testing.assert_allclose(predict(read_back, motion), expected, atol=1e-9 * np.abs(expected).max())
