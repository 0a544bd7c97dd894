"""Every effect of the catalogue at every joint as torque columns: the residual to expect if that effect were missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from calib.diagnosis.model import LogModel
from calib.measurement.observed import Key
from sim.arm import ArmEffect
from sim.effects import EFFECTS, Effect, Stage, driven_by, effect_named
from sim.motion_view import CandidateColumns


@dataclass(frozen=True)
class Candidate(CandidateColumns):
    """An effect at a joint (None: the whole arm) with its columns per recording; number: which of its starts, from 1."""

    effect: str = ""
    joint: str | None = None
    number: int = 0

    @property
    def key(self) -> Key:
        """Effect and joint."""
        return self.effect, self.joint


Wanted = Callable[[Effect, int | None], bool]


def candidates(models: Sequence[LogModel], wanted: Wanted | None = None) -> Iterator[Candidate]:
    """All candidates under the present hypothesis, or those `wanted`, each with every start of its nonlinear parameters."""
    joints: list[tuple[int | None, str | None]] = list(enumerate(models[0].arm.joint_names))
    for effect in EFFECTS:
        for j, joint in joints if effect.scope == "joint" else [(None, None)]:
            if wanted is not None and not wanted(effect, j):
                continue
            for number, c in enumerate(effect.columns(models, j), 1):
                yield Candidate(c.columns, c.combine, c.spread, effect.name, joint, number)


def of(item: ArmEffect, joint_names: Sequence[str]) -> Wanted:
    """Filter for the effect of `item` at its joint alone."""
    at = None if item.joint is None else joint_names.index(item.joint)
    return lambda effect, j: (effect.name, j) == (item.effect, at)


def in_place_of(item: ArmEffect, joint_names: Sequence[str]) -> Wanted:
    """Filter for effects that may replace `item`: both change the torque of a common joint."""
    at, everywhere = {joint_names.index(joint) for joint in acts_at(item, joint_names)}, acts_everywhere(item)

    def wanted(effect: Effect, j: int | None) -> bool:
        return everywhere or j is None or effect.stage < Stage.JOINT or j in at

    return wanted


def acts_everywhere(item: ArmEffect) -> bool:
    """Whether an effect changes the torque of many joints: it belongs to the whole arm, or changes angles, bodies or forces."""
    return item.joint is None or effect_named(item.effect).stage < Stage.JOINT


def acts_at(item: ArmEffect, joint_names: Sequence[str]) -> set[str]:
    """The joint of an effect and the joint it is driven through; empty for an effect of the whole arm."""
    return {joint for joint in (item.joint, driven_by(joint_names, item)) if joint is not None}
