"""Every effect of the catalogue at every joint as columns of torque: what the residual would look like if that effect were missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from calib.diagnosis.model import LogModel
from calib.measurement.observed import Key
from sim.arm import ArmEffect
from sim.effects import EFFECTS, driven_by
from sim.motion_view import CandidateColumns


@dataclass(frozen=True)
class Candidate(CandidateColumns):
    """An effect at a joint (None: the whole arm) with its columns per recording."""

    effect: str = ""
    joint: str | None = None

    @property
    def key(self) -> Key:
        """Effect and joint."""
        return self.effect, self.joint


def candidates(models: Sequence[LogModel]) -> Iterator[Candidate]:
    """All candidates at the present hypothesis, each with every start of its nonlinear parameters."""
    joints: list[tuple[int | None, str | None]] = list(enumerate(models[0].arm.joint_names))
    for effect in EFFECTS:
        for j, joint in joints if effect.scope == "joint" else [(None, None)]:
            for c in effect.columns(models, j):
                yield Candidate(c.columns, c.combine, c.spread, effect.name, joint)


def acts_at(item: ArmEffect, joint_names: Sequence[str]) -> set[str]:
    """The joint of an effect, and the one that it is driven through; none of an effect of the whole arm."""
    return {joint for joint in (item.joint, driven_by(joint_names, item)) if joint is not None}
