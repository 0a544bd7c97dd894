"""Effects that an arm.toml lists: checked against the catalogue; those that change bodies become part of the arm's model."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path

from sim.arm import Arm, ArmEffect, model_effects
from sim.arm_folder import model_text, with_effects
from sim.arm_table import EffectTable
from sim.effects import Stage, checked, effect_named
from sim.errors import ConfigError
from sim.model import compiled, kinematic_tree
from sim.resources import nearest
from sim.tree import KinematicTree


def with_listed(arm: Arm, listed: Collection[EffectTable], file: Path) -> Arm:
    """The arm with the effects of `file`: a payload, a tilted base or a changed link in its model, all others in its effects.

    ConfigError if the catalogue or the arm does not know an effect, a parameter is out of bounds, or the model contradicts it.
    """
    native = {e.key for e in arm.effects}
    arm = replace(arm, effects=_all_effects(listed, arm.tree, file))
    try:
        beside = [checked(arm, e) for e in arm.effects if e.key not in native]
        bodies = [e for e in beside if effect_named(e.effect).stage is Stage.RIGID]
        return _with_bodies(arm, bodies) if bodies else arm
    except ConfigError as error:
        raise ConfigError(f"{file}: [[effects]]: {error}") from None


def _with_bodies(arm: Arm, bodies: Collection[ArmEffect]) -> Arm:
    changed = replace(arm, effects=tuple(e for e in arm.effects if e not in bodies))
    text, _ = model_text(*with_effects(changed, bodies))
    tree = kinematic_tree(compiled(text, arm.model_path.parent, str(arm.model_path)))
    return replace(changed, model_text=text, tree=replace(tree, dq_max=arm.tree.dq_max))


def _all_effects(listed: Iterable[EffectTable], tree: KinematicTree, file: Path) -> tuple[ArmEffect, ...]:
    """The model's effects, then those of arm.toml; one in both must have the same values, and gets its std from arm.toml."""
    from_model = dict(effects := {e.key: e for e in model_effects(tree)})
    for item in listed:
        key, parameters = (item.effect, item.joint), dict(item.parameters)
        if item.joint is not None and item.joint not in tree.joint_names:
            raise ConfigError(f"{file}: effects: {item.effect}: joint {item.joint!r}; {nearest(item.joint, tree.joint_names)}")
        own = from_model.pop(key, None)
        if own is None and key in effects:
            raise ConfigError(f"{file}: effects: {item.effect} of {item.joint or 'the arm'} is listed twice; keep one")
        if own is not None and not _same(own.parameters, parameters):
            raise ConfigError(
                f"{file}: effects: {item.effect} of {item.joint} is {parameters}, but the model file has {own.parameters}; "
                "the model is what is simulated: make both the same, or remove the entry here"
            )
        effects[key] = ArmEffect(item.effect, item.joint, parameters if own is None else own.parameters, dict(item.std))
    return tuple(effects.values())


def _same(a: dict[str, float], b: dict[str, float]) -> bool:
    return a.keys() == b.keys() and all(math.isclose(a[k], b[k], rel_tol=1e-12, abs_tol=1e-15) for k in a)
