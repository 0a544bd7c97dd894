"""tau_hat(t): the torque that the drives of an arm report along a motion, with every effect that the arm has.

The path follows the stages of `sim.effects.effect`: encoder, rigid bodies, forces, joint, transmission, friction, motor, drive,
sensor, channel. It takes the motion as the encoders read it and returns the torque as the drives report it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numba
import numpy as np

from sim.arm import Arm, ArmEffect
from sim.effects import Stage, effect_named
from sim.effects.effect import Effect, PathState
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

# Displacement over which dry friction builds up where nothing says otherwise: the order of the asperity contacts of bearings,
# 1e-5 to 1e-4 m on a radius of some centimetres (B. Armstrong-Helouvry 1991, Control of Machines with Friction, chapter 2).
SLIP_WIDTH = 1e-4


@numba.njit(cache=True)
def slip_direction(q: np.ndarray, width: np.ndarray, start: float = 0.0) -> np.ndarray:
    """z in [-1, 1]: dz = dq/width, held at the ends (Prandtl's element); q (N,) rad, width (N,) rad."""
    z = np.empty(len(q))
    z[0] = start
    for k in range(1, len(q)):
        z[k] = min(1.0, max(-1.0, z[k - 1] + (q[k] - q[k - 1]) / width[k]))
    return z


def predict(arm: Arm, motion: Trajectory) -> np.ndarray:
    """tau_hat (N, n) N m as the drives of `arm` would report it along `motion`, whose angles are encoder readings."""
    return torque_path(arm, motion).tau


def torque_path(
    arm: Arm, motion: Trajectory, effects: Iterable[ArmEffect] | None = None, slip_width: float = SLIP_WIDTH
) -> PathState:
    """Every stage of the torque path along `motion`; `effects` replaces the arm's own list where it is given."""
    stages = by_stage(arm.effects if effects is None else effects, arm)
    t = motion.t - motion.t[0]
    shape = motion.q.shape
    state = PathState(
        t=t, q=motion.q.copy(), dq=motion.dq.copy(), ddq=motion.ddq.copy(), load=np.zeros(shape), q_motor=np.zeros(shape),
        dq_motor=np.zeros(shape), ddq_motor=np.zeros(shape), level=np.zeros(shape), width=np.full(shape, slip_width),
        warmth=np.ones(shape), slip=np.zeros(shape), tau=np.zeros(shape), force=np.zeros((len(t), 3)),
    )  # fmt: skip
    run = _Runner(state, stages)
    run.stage(Stage.ENCODER)
    bodies = RigidBody(arm)
    state.load += bodies.inverse_dynamics(state.q, state.dq, state.ddq)
    if stages[Stage.FORCE]:
        run.stage(Stage.FORCE)
        linear, _ = bodies.jacobian(state.q)
        state.load -= np.einsum("kcj,kc->kj", linear, state.force)
    run.stage(Stage.JOINT)
    state.q_motor[:], state.dq_motor[:], state.ddq_motor[:] = state.q, state.dq, state.ddq
    if stages[Stage.TRANSMISSION]:
        run.stage(Stage.TRANSMISSION)
        twist = state.q_motor - state.q
        state.dq_motor += np.gradient(twist, t, axis=0)
        state.ddq_motor += np.gradient(np.gradient(twist, t, axis=0), t, axis=0)
    run.stage(Stage.FRICTION)
    for j in range(shape[1]):
        state.slip[:, j] = slip_direction(state.q_motor[:, j], state.width[:, j])
    state.tau += state.load + state.warmth * state.level * state.slip
    run.stage(Stage.MOTOR)
    run.stage(Stage.DRIVE)
    run.stage(Stage.SENSOR)
    run.stage(Stage.CHANNEL)
    return state


Stages = dict[Stage, list[tuple[Effect, int | None, ArmEffect]]]


def by_stage(effects: Iterable[ArmEffect], arm: Arm) -> Stages:
    """The effects sorted by stage, each with its joint's index; gains before offsets, widths after levels."""
    stages: Stages = {stage: [] for stage in Stage}
    for item in effects:
        effect = effect_named(item.effect)
        stages[effect.stage].append((effect, None if item.joint is None else arm.joint_index(item.joint), item))
    for items in stages.values():
        items.sort(key=lambda entry: _ORDER.get(entry[0].name, 0))
    return stages


# Within a stage the order matters twice: a reading is gain * torque + offset, and the width of slip follows from the whole level.
_ORDER = {"torque_offset": 1, "presliding_friction": 1}


class _Runner:
    def __init__(self, state: PathState, stages: Stages) -> None:
        self.state, self.stages = state, stages

    def stage(self, stage: Stage) -> None:
        for effect, joint, item in self.stages[stage]:
            effect.apply(self.state, joint, item.parameters)
