"""Catalogue of effects: one file per effect and one line in OWN_EFFECTS; everything else about effects is derived from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sim.arm import Arm, ArmEffect
from sim.effects.asymmetric_friction import AsymmetricFriction
from sim.effects.backlash import Backlash
from sim.effects.base_tilt import BaseTilt
from sim.effects.coulomb_friction import CoulombFriction
from sim.effects.effect import Effect, Parameter
from sim.effects.encoder_eccentricity import EncoderEccentricity
from sim.effects.encoder_offset import EncoderOffset
from sim.effects.external_contact import ExternalContact
from sim.effects.friction_law import FrictionLaw
from sim.effects.gear_ripple import GearRipple
from sim.effects.joint_elasticity import JointElasticity
from sim.effects.joint_spring import JointSpring
from sim.effects.link_inertia import LinkInertia
from sim.effects.load_dependent_friction import LoadDependentFriction
from sim.effects.nonlinear_viscous_friction import NonlinearViscousFriction
from sim.effects.payload import Payload
from sim.effects.presliding_friction import PreslidingFriction
from sim.effects.rotor_inertia import RotorInertia
from sim.effects.stribeck_friction import StribeckFriction
from sim.effects.thermal_friction import ThermalFriction
from sim.effects.time_delay import TimeDelay
from sim.effects.tool_force import ToolForce
from sim.effects.torque_gain import TorqueGain
from sim.effects.torque_offset import TorqueOffset
from sim.effects.torque_ripple import TorqueRipple
from sim.effects.torque_saturation import TorqueSaturation
from sim.effects.transmission_coupling import TransmissionCoupling
from sim.effects.viscous_friction import ViscousFriction
from sim.errors import ConfigError
from sim.mjcf_form import Exported, JointSize, Mjcf
from sim.plugins import OWN, check_names, loaded, origin, plugins
from sim.resources import nearest
from sim.torque_path import PathState, Stage

OWN_EFFECTS: tuple[Effect, ...] = (
    CoulombFriction(),
    ViscousFriction(),
    AsymmetricFriction(),
    StribeckFriction(),
    NonlinearViscousFriction(),
    LoadDependentFriction(),
    ThermalFriction(),
    PreslidingFriction(),
    RotorInertia(),
    JointElasticity(),
    Backlash(),
    TorqueRipple(),
    JointSpring(),
    TorqueGain(),
    TorqueOffset(),
    TorqueSaturation(),
    EncoderOffset(),
    EncoderEccentricity(),
    TimeDelay(),
    Payload(),
    LinkInertia(),
    BaseTilt(),
    ToolForce(),
    ExternalContact(),
    TransmissionCoupling(),
)

# laws that a fit adds to an arm besides the named effects; a diagnosis does not search for them
LAWS: tuple[Effect, ...] = (FrictionLaw(), GearRipple())

# unusable effect of another package -> reason; usable ones are treated like our own
BROKEN: dict[str, str] = {}


def _of_packages() -> tuple[Effect, ...]:
    """Effects that installed packages add (entry point arm_calib.effects), sorted by name; unusable ones go to BROKEN."""
    found = []
    check_names("effects", (e.name for e in (*OWN_EFFECTS, *LAWS)))
    for name, entry in sorted(plugins("effects").items()):
        try:
            effect = loaded(entry, Effect)
            effect = effect() if isinstance(effect, type) else effect
            if effect.name != name:
                raise ConfigError(f"effect {name!r} of {origin(entry)} calls itself {effect.name!r}; ask its authors")
        except ConfigError as error:
            BROKEN[name] = str(error)
            continue
        found.append(effect)
    return tuple(found)


EFFECTS: tuple[Effect, ...] = (*OWN_EFFECTS, *_of_packages())
_BY_NAME = {effect.name: effect for effect in (*EFFECTS, *LAWS)}


def effect_origin(name: str) -> str:
    """Package and version that an effect comes from."""
    entry = plugins("effects").get(name)
    return origin(entry) if entry else OWN


def effect_named(name: str) -> Effect:
    """The effect of that name; ConfigError suggests the nearest name, or states why a package's effect cannot be used."""
    if name in BROKEN:
        raise ConfigError(BROKEN[name])
    try:
        return _BY_NAME[name]
    except KeyError:
        raise ConfigError(f"there is no effect {name!r}; {nearest(name, [e.name for e in EFFECTS])}") from None


def checked(arm: Arm, instance: ArmEffect) -> ArmEffect:
    """Return `instance` if the catalogue has its effect, the arm its joint, and its parameters are valid; else ConfigError."""
    effect = effect_named(instance.effect)
    if effect.scope == "joint" and instance.joint is None:
        raise ConfigError(f"effect {effect.name}: a joint is needed; joints: {', '.join(arm.joint_names)}")
    within_bounds(instance)
    if instance.joint is not None:
        arm.joint_index(instance.joint)
        driven_by(arm.joint_names, instance)
    return instance


def within_bounds(instance: ArmEffect) -> None:
    """ConfigError if the effect is unknown, its scope or its parameter names do not match, or a parameter is out of bounds."""
    effect = effect_named(instance.effect)
    where = f"effect {instance.effect}" + (f" at {instance.joint}" if instance.joint else "")
    if effect.scope == "joint" and instance.joint is None:
        raise ConfigError(f"{where}: a joint is needed")
    if effect.scope != "joint" and instance.joint is not None:
        raise ConfigError(f"{where}: this effect belongs to the whole arm; leave the joint out")
    names = [p.name for p in effect.parameters]
    if sorted(instance.parameters) != sorted(names):
        raise ConfigError(f"{where}: parameters {sorted(instance.parameters)}; needs exactly {names}")
    for p in effect.parameters:
        value = instance.parameters[p.name]
        if not p.lower <= value <= p.upper:
            raise ConfigError(f"{where}: {p.name} = {value} {p.unit}; must lie between {p.lower:g} and {p.upper:g}")


def driven_by(joint_names: Sequence[str], instance: ArmEffect) -> str | None:
    """Joint through which the effect's joint is driven; None for other effects. ConfigError for the first joint of the chain."""
    effect = effect_named(instance.effect)
    if instance.joint is None or not effect.driven:
        return None
    return joint_names[effect.joint_before(joint_names.index(instance.joint))]


def with_effect(arm: Arm, instance: ArmEffect) -> Arm:
    """The arm with that effect: rigid effects change its bodies, any other replaces the arm's own of that name and joint."""
    effect = effect_named(checked(arm, instance).effect)
    joint = None if instance.joint is None else arm.joint_index(instance.joint)
    if effect.stage is Stage.RIGID:
        return replace(arm, tree=effect.bodies(arm.tree, joint, instance.parameters))
    others = tuple(e for e in arm.effects if e.key != instance.key)
    return replace(arm, effects=(*others, instance))


__all__ = [
    "BROKEN",
    "EFFECTS",
    "LAWS",
    "Effect",
    "Exported",
    "JointSize",
    "Mjcf",
    "Parameter",
    "PathState",
    "Stage",
    "checked",
    "driven_by",
    "effect_named",
    "effect_origin",
    "with_effect",
    "within_bounds",
]
