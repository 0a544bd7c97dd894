"""The corrected arm: the named effects, and the ordinary parameters where the same fit puts them within their priors.

The two belong together: without the effect, the ordinary parameters would take its place.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.link_side import centre_size
from calib.diagnosis.nuisance import ROTOR_TOGETHER, spreads
from calib.diagnosis.parameters import seen
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.effects.gear_ripple import GearRipple
from sim.effects.presliding_friction import built_up
from sim.slip import SLIP_WIDTH

WIDER = 1.5
Inertial = tuple[float, np.ndarray, np.ndarray]
# effect -> its symbol among a model's nuisance parameters, and its key in sim.prior.spread
ORDINARY = {
    "coulomb_friction": ("Fc", "coulomb"),
    "viscous_friction": ("Fv", "viscous"),
    "rotor_inertia": ("Ia", "rotor"),
    "torque_offset": ("offset", "offset"),
}


@dataclass(frozen=True)
class ArmChange:
    """Changes of an arm: joint -> (mass kg, com (3,) m, inertia (3, 3) kg m^2 about it) of the link it moves, and effects."""

    inertials: dict[str, Inertial]
    effects: tuple[ArmEffect, ...]

    def of(self, arm: Arm) -> Arm:
        """The arm with these changes."""
        for item in self.effects:
            arm = with_effect(arm, item)
        mass, com, inertia = arm.tree.mass.copy(), arm.tree.com.copy(), arm.tree.inertia.copy()
        for joint, (m, c, i) in self.inertials.items():
            j = arm.joint_index(joint)
            mass[j], com[j], inertia[j] = m, c, i
        return replace(arm, tree=replace(arm.tree, mass=mass, com=com, inertia=inertia))


def correction(f: Fit, limits: Sequence[ArmEffect] = (), joints: Collection[int] | None = None) -> ArmChange:
    """The accepted effects with their standard deviations, the fitted masses, friction and reflected inertia, and limits.

    joints: only their friction and reflected inertia change, and every link stays as it was; None: all change. A contact is an
    event and is left out. A link whose inertia is named stays as named, and so does the last link under a payload.
    """
    model, start = f.models[0], f.hypothesis.start
    theta = dict(zip(model.names, f.solved.theta, strict=True))
    named = [(e, s) for e, s in zip(f.accepted, f.std(), strict=True) if e.effect != CONTACT]
    taken = {e.joint for e, _ in named if e.effect == "link_inertia"}
    if any(e.effect == "payload" for e, _ in named):
        taken.add(start.joint_names[-1])
    moving = start.joint_names if joints is None else [start.joint_names[j] for j in joints]
    links = [(i, joint) for i, joint in enumerate(start.joint_names) if joints is None and joint not in taken]
    inertials = {joint: _inertial(start, i, theta) for i, joint in links}
    effects = [replace(e, parameters=_moved(e, start, theta), std=finite(e, s)) for e, s in named]
    have = {e.key for e, _ in named}
    effects += [
        replace(e, parameters=_moved(e, start, theta)) if e.joint in moving else e
        for e in start.effects
        if e.effect in ORDINARY and e.key not in have
    ]
    built = [e for e in (*_build_up(f.hypothesis, effects), *ripples(f)) if e.joint in moving]
    return ArmChange(inertials, (*effects, *built, *limits))


def names_alone(f: Fit, limits: Sequence[ArmEffect] = ()) -> ArmChange:
    """The accepted effects and nothing else of the fit; a contact is no property of the arm."""
    named = [
        replace(e, parameters={k: float(v) for k, v in e.parameters.items()}, std=finite(e, s))
        for e, s in zip(f.accepted, f.std(), strict=True)
        if e.effect != CONTACT
    ]
    return ArmChange({}, (*named, *limits))


def _build_up(hypothesis: Hypothesis, effects: Sequence[ArmEffect]) -> list[ArmEffect]:
    """Presliding friction of joints whose dry friction builds up over more than WIDER times SLIP_WIDTH."""
    out, have = [], {e.key for e in (*effects, *hypothesis.start.effects)}
    for joint, width in zip(hypothesis.start.joint_names, hypothesis.width, strict=True):
        level = next((e.parameters["coulomb"] for e in effects if e.effect == "coulomb_friction" and e.joint == joint), 0.0)
        if width > WIDER * SLIP_WIDTH and level > 0 and ("presliding_friction", joint) not in have:
            out += built_up(joint, float(level), float(width))
    return out


def ripples(f: Fit) -> list[ArmEffect]:
    """The fitted ripple of every gear that has one, with its standard deviations."""
    names, out = f.models[0].names, []
    for j, (joint, ripple) in enumerate(zip(f.hypothesis.start.joint_names, f.hypothesis.ripples, strict=False)):
        if ripple is None:
            continue
        first = names.index(f"ripple_sin_{j + 1}")
        c = -ripple.size * f.solved.theta[first : first + 2]
        amplitude = max(float(np.hypot(*c)), 1e-12)
        std = ripple.size * float(np.sqrt(np.mean(np.diag(f.solved.inverse)[first : first + 2])))
        values = {"amplitude": amplitude, "cycles": ripple.cycles, "phase": float(np.arctan2(c[1], c[0]))}
        out.append(ArmEffect(GearRipple.name, joint, values, {"amplitude": std, "phase": min(std / amplitude, np.pi)}))
    return out


def _inertial(arm: Arm, i: int, theta: dict[str, float]) -> Inertial:
    """Link i: m scales mass and inertia, c moves the centre of mass, I scales inertia about it; scales are at least 0.1."""
    prior, tree, k = arm.prior, arm.tree, i + 1
    scale = max(0.1, 1.0 + prior.mass * theta[f"m_{k}"])
    wider = max(0.1, 1.0 + prior.inertia * theta[f"I_{k}"])
    size = centre_size(arm, i)
    moved = prior.com * size * np.array([theta[f"c{axis}_{k}"] for axis in "xyz"])
    return float(tree.mass[i] * scale), tree.com[i] + moved, tree.inertia[i] * scale * wider


def _moved(item: ArmEffect, arm: Arm, theta: dict[str, float]) -> dict[str, float]:
    """Fitted friction and reflected inertia, never below zero, and fitted offsets; other effects unchanged."""
    if item.effect not in ORDINARY or item.joint is None:
        return {name: float(value) for name, value in item.parameters.items()}
    j = arm.joint_index(item.joint)
    symbol, spread = ORDINARY[item.effect]
    change = float(spreads(arm)[spread][j]) * theta[f"{symbol}_{j + 1}"]
    (name, value), *_ = item.parameters.items()
    if item.effect == "rotor_inertia":
        change += ROTOR_TOGETHER * theta["Ia_all"] * value
    return {name: float(value + change if item.effect == "torque_offset" else max(0.0, value + change))}


def finite(item: ArmEffect, std: dict[str, float]) -> dict[str, float]:
    """The standard deviations that an arm's file can hold: finite, positive, and of identifiable parameters."""
    own = {p.name: p for p in effect_named(item.effect).parameters}
    return {k: v for k, v in std.items() if np.isfinite(v) and v > 0 and seen(own[k], item.parameters[k], v)}
