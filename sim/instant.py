"""The torque path at one instant, for effects that are applied step by step."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim.arm import ArmEffect
from sim.effects.effect import Effect
from sim.slip import SLIP_WIDTH
from sim.torque_path import PathState


def instant(time: float, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, torque: np.ndarray | None = None) -> PathState:
    """Path of one sample at q dq ddq (n,) of the motors: zero load, slip as the sign of the speed, torque (n,) N m or zero."""
    # one array for all rows: this is called at every step of a simulation
    rows = np.zeros((12, 1, len(q)))
    rows[0:2], rows[2:4], rows[4:6], rows[6], rows[7] = q, dq, ddq, SLIP_WIDTH, 1.0
    np.sign(dq, out=rows[8, 0])
    if torque is not None:
        rows[9] = torque
    angle, motor, speed, motor_speed, push, motor_push, width, warmth, slip, tau, load, level = rows
    return PathState(
        t=np.array([time]), q=angle, dq=speed, ddq=push, load=load, q_motor=motor, dq_motor=motor_speed, ddq_motor=motor_push,
        level=level, width=width, warmth=warmth, slip=slip, tau=tau, force=np.zeros((1, 3)),
    )  # fmt: skip


def apply_all(state: PathState, effects: Iterable[tuple[Effect, int | None, ArmEffect]]) -> None:
    """Apply each effect to the path at its joint."""
    for effect, joint, item in effects:
        effect.apply(state, joint, item.parameters)
