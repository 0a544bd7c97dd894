"""Parameters of accepted effects: which are fitted, in which units, and within which bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.diagnosis.hypothesis import Hypothesis
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named
from sim.effects.effect import Parameter
from sim.errors import ConfigError


def parameters_of(accepted: Sequence[ArmEffect]) -> list[tuple[int, Parameter]]:
    """(index of the effect, parameter) of every parameter that is fitted."""
    return [
        (i, p)
        for i, item in enumerate(accepted)
        for p in effect_named(item.effect).parameters
        if not p.chosen(item.parameters[p.name])
    ]


def nominal_values(arm: Arm, item: ArmEffect) -> dict[str, float | None]:
    """The arm's values in place of an effect: its own, else those at which the effect vanishes, None for a shape."""
    own = arm.effect(item.effect, item.joint)
    if item.effect == "link_inertia" and item.joint is not None:
        j = arm.joint_index(item.joint)
        return dict(zip(("mass", "com_x", "com_y", "com_z"), map(float, (arm.tree.mass[j], *arm.tree.com[j])), strict=True))
    return dict(own.parameters) if own else {p.name: p.zero for p in effect_named(item.effect).parameters}


def logarithmic(p: Parameter) -> bool:
    """Whether a parameter is fitted as a logarithm: a scale without a zero."""
    return p.zero is None and p.lower > 0


def seen(p: Parameter, value: float, std: float) -> bool:
    """Whether a parameter is identifiable: its standard deviation is below that of a uniform distribution over its bounds.

    Where the logarithm is fitted, the logarithm is compared. NaN, a deviation that was not computed, counts as identifiable.
    """
    if logarithmic(p):
        return not std / abs(value) >= np.log(p.upper / p.lower) / np.sqrt(12.0)
    return not std >= (p.upper - p.lower) / np.sqrt(12.0)


def within(item: ArmEffect) -> bool:
    """Whether every parameter is finite and inside its physical bounds."""
    bounds = {p.name: p for p in effect_named(item.effect).parameters}
    return all(np.isfinite(v) and bounds[k].lower <= v <= bounds[k].upper for k, v in item.parameters.items())


def changed(item: ArmEffect, p: Parameter, by: float) -> ArmEffect:
    """The effect with one parameter moved by `by` in fitting units, clipped to its bounds; a logarithm moves by at most 1."""
    value = item.parameters[p.name]
    value = value * float(np.exp(np.clip(by, -1.0, 1.0))) if logarithmic(p) else value + by
    return replace(item, parameters=dict(item.parameters) | {p.name: float(np.clip(value, p.lower, p.upper))})


def moved(hypothesis: Hypothesis, change: np.ndarray) -> Hypothesis:
    """The hypothesis with accepted parameters moved by `change` (k,) in fitting units, within bounds.

    It stays unchanged if that is no valid arm (ConfigError).
    """
    accepted = list(hypothesis.accepted)
    for (i, p), by in zip(parameters_of(hypothesis.accepted), change, strict=True):
        accepted[i] = changed(accepted[i], p, float(by))
    try:
        return hypothesis.with_effects(tuple(accepted), hypothesis.event_log)
    except ConfigError:
        return hypothesis
