"""The torque path at one instant, for effects that are applied as time goes on."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim.arm import ArmEffect
from sim.effects.effect import Effect
from sim.slip import SLIP_WIDTH
from sim.torque_path import PathState


def instant(time: float, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, torque: np.ndarray | None = None) -> PathState:
    """A path of one sample with q dq ddq (n,) of the motors, no load yet, slip as the speed has it, and torque (n,) N m or none."""
    q, dq, ddq = (x[None].copy() for x in (q, dq, ddq))
    zero = np.zeros_like(q)
    return PathState(
        t=np.array([time]), q=q, dq=dq, ddq=ddq, load=zero.copy(), q_motor=q.copy(), dq_motor=dq.copy(), ddq_motor=ddq.copy(),
        level=zero.copy(), width=np.full_like(q, SLIP_WIDTH), warmth=np.ones_like(q), slip=np.sign(dq),
        tau=zero.copy() if torque is None else torque[None].copy(), force=np.zeros((1, 3)),
    )  # fmt: skip


def apply_all(state: PathState, effects: Iterable[tuple[Effect, int | None, ArmEffect]]) -> None:
    """Let each effect add what it does to its joint."""
    for effect, joint, item in effects:
        effect.apply(state, joint, item.parameters)
