"""Whether the friction of an arm dissipates energy, as in every passive joint: F(v) v >= 0 in steady motion.

Friction that drives its joint is not physical. It comes from readings that leave out what a controller adds, such as friction
compensation, or from readings with reversed sign. An arm with it predicts such readings, and diverges in a simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.arm import Arm
from sim.effects import Stage, effect_named
from sim.prediction import by_stage, motor_side
from sim.torque_path import PathState

SPEEDS = 10  # of each joint, up to its fastest
TRAVEL, STEPS = 2.0, 50  # rad of travel until dry friction has built up, and the number of steps


@dataclass(frozen=True)
class DrivingFriction:
    """A joint driven by its friction: the most negative friction torque N m against motion, and its speed rad/s."""

    joint: str
    torque: float
    speed: float


def steady_friction(arm: Arm, speed: np.ndarray) -> np.ndarray:
    """(n,) N m: friction against steady motion at speed (n,) rad/s, mean of both directions, without load and cold."""
    acting = [e for e in arm.effects if effect_named(e.effect).stage in (Stage.FRICTION, Stage.MOTOR)]
    stages, shape = by_stage(acting, arm), (STEPS, arm.n)
    torque = []
    for dq in (speed, -speed):
        # one time base for all joints: slip depends on the distance travelled, not on the time it takes
        t, nothing = np.linspace(0.0, 1.0, STEPS), np.zeros(shape)
        q = np.sign(dq) * TRAVEL * t[:, None]
        state = PathState(
            t=t, q=q, dq=np.broadcast_to(dq, shape).copy(), ddq=nothing.copy(), load=nothing.copy(), q_motor=nothing.copy(),
            dq_motor=nothing.copy(), ddq_motor=nothing.copy(), level=nothing.copy(), width=nothing.copy(),
            warmth=np.ones(shape), slip=nothing.copy(), tau=nothing.copy(), force=np.zeros((STEPS, 3)),
        )  # fmt: skip
        motor_side(state, stages)
        torque.append(state.tau[-1])
    return np.asarray((torque[0] - torque[1]) / 2)


def driving_friction(arm: Arm, fastest: np.ndarray, least: np.ndarray) -> list[DrivingFriction]:
    """The joints whose friction drives them with more than least (n,) N m at some speed up to fastest (n,) rad/s."""
    speeds = np.linspace(1.0 / SPEEDS, 1.0, SPEEDS)[:, None] * fastest
    torque = np.array([steady_friction(arm, speed) for speed in speeds])
    worst = torque.argmin(axis=0)
    return [
        DrivingFriction(joint, float(torque[k, j]), float(speeds[k, j]))
        for j, (joint, k) in enumerate(zip(arm.joint_names, worst, strict=True))
        if torque[k, j] < -least[j]
    ]
