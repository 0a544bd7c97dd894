"""tau_hat(t): the torque that the drives of an arm report along a motion, with every effect that the arm has.

The path follows the stages of `sim.effects.effect`: encoder, rigid bodies, forces, joint, transmission, friction, motor, drive,
sensor, channel. It takes the motion as the encoders read it and returns the torque as the drives report it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim.arm import Arm, ArmEffect
from sim.effects import Stage, effect_named
from sim.effects.effect import Effect
from sim.rigid_body import RigidBody
from sim.slip import SLIP_WIDTH, slip_along
from sim.torque_path import PathState, Slip
from sim.trajectory import Trajectory

# s of standing still before the torque is read: longer than any delay of a reading
STANDING = 1.0


def predict(arm: Arm, motion: Trajectory, warming: np.ndarray | None = None) -> np.ndarray:
    """tau_hat (N, n) N m as the drives of `arm` would report it along `motion`, whose angles are encoder readings.

    warming (N, n): share of the way from cold to warm, where temperatures were recorded; otherwise the motion begins cold.
    """
    return torque_path(arm, motion, warming=warming).tau


def at_rest(arm: Arm, q: np.ndarray) -> np.ndarray:
    """(K, n) N m that the drives of `arm` report at rest at encoder readings q (K, n) rad, cold and without dry friction.

    It includes every effect of the arm: a spring or a counterbalance carries part of g(q). NaN for a posture with an angle that
    is not finite.
    """
    out, still = np.full(q.shape, np.nan), np.zeros((2, q.shape[1]))
    for k in np.flatnonzero(np.isfinite(q).all(axis=1)).tolist():
        out[k] = predict(arm, Trajectory(np.array([0.0, STANDING]), np.stack([q[k], q[k]]), still, still))[-1]
    return out


def torque_path(
    arm: Arm,
    motion: Trajectory,
    effects: Iterable[ArmEffect] | None = None,
    warming: np.ndarray | None = None,
) -> PathState:
    """Every stage of the torque path along `motion`; `effects` replaces the arm's own list where it is given."""
    stages = by_stage(arm.effects if effects is None else effects, arm)
    state = link_side(arm, motion, stages, warming)
    motor_side(state, stages)
    return state


def link_side(arm: Arm, motion: Trajectory, stages: Stages, warming: np.ndarray | None = None) -> PathState:
    """The path up to the load that the links and external forces put on the gears: stages ENCODER, RIGID and FORCE."""
    t, shape = motion.t - motion.t[0], motion.q.shape
    state = PathState(
        t=t, q=motion.q.copy(), dq=motion.dq.copy(), ddq=motion.ddq.copy(), load=np.zeros(shape), q_motor=np.zeros(shape),
        dq_motor=np.zeros(shape), ddq_motor=np.zeros(shape), level=np.zeros(shape), width=np.zeros(shape),
        warmth=np.ones(shape), slip=np.zeros(shape), tau=np.zeros(shape), force=np.zeros((len(t), 3)), warming=warming,
    )  # fmt: skip
    _run(state, stages, Stage.ENCODER)
    put_load(state, stages, RigidBody(arm))
    return state


def put_load(state: PathState, stages: Stages, bodies: RigidBody) -> None:
    """Set the load to what links and external forces need along the path: stages RIGID and FORCE."""
    state.load[:] = bodies.inverse_dynamics(state.q, state.dq, state.ddq)
    if stages[Stage.FORCE]:
        state.force[:] = 0.0
        _run(state, stages, Stage.FORCE)
        linear, _ = bodies.jacobian(state.q)
        state.load -= np.einsum("kcj,kc->kj", linear, state.force)


def motor_side(state: PathState, stages: Stages, width: np.ndarray | None = None, lead: np.ndarray | None = None) -> None:
    """The rest of the path, in place: stages JOINT to CHANNEL; works on any subset of the joints.

    width (n,) rad and lead (n,) s describe how the dry friction of each joint builds up after a reversal.
    """
    gear_side(state, stages)
    behind_the_gear(state, stages, width, lead)


def gear_side(state: PathState, stages: Stages) -> None:
    """The motion of the motors and the load on their gears, in place: stages JOINT and TRANSMISSION."""
    _run(state, stages, Stage.JOINT)
    state.q_motor[:], state.dq_motor[:], state.ddq_motor[:] = state.q, state.dq, state.ddq
    if stages[Stage.TRANSMISSION]:
        _run(state, stages, Stage.TRANSMISSION)
        twist = state.q_motor - state.q
        speed = np.gradient(twist, state.t, axis=0)
        state.dq_motor += speed
        state.ddq_motor += np.gradient(speed, state.t, axis=0)


def load_on_gears(arm: Arm, motion: Trajectory) -> np.ndarray:
    """(N, n) N m that links, external forces and springs put on the gears along `motion`; no friction, motors or sensors."""
    stages = by_stage(arm.effects, arm)
    state = link_side(arm, motion, stages)
    gear_side(state, stages)
    return state.load


def dahl(state: PathState, joint: int, lead: float) -> np.ndarray:
    """(N,) the direction of dry friction by Dahl's law along the motion of the motor."""
    columns = (np.ascontiguousarray(x[:, joint]) for x in (state.q_motor, state.dq_motor, state.width))
    return np.asarray(slip_along(state.t, *columns, lead))


def behind_the_gear(
    state: PathState, stages: Stages, width: np.ndarray | None = None, lead: np.ndarray | None = None, slip: Slip = dahl
) -> None:
    """The torque from the motors' motion and the load on their gears, in place: stages FRICTION to CHANNEL.

    slip: the law for joints whose effects bring none of their own.
    """
    state.width[:] = SLIP_WIDTH if width is None else width
    _run(state, stages, Stage.FRICTION)
    for j in range(state.q.shape[1]):
        state.slip[:, j] = state.slips.get(j, slip)(state, j, 0.0 if lead is None else float(lead[j]))
    state.tau += state.load + state.warmth * state.level * state.slip
    for stage in (Stage.MOTOR, Stage.DRIVE, Stage.SENSOR, Stage.CHANNEL):
        _run(state, stages, stage)


def torque_of_laws(laws: Iterable[ArmEffect], arm: Arm, motion: Trajectory) -> np.ndarray:
    """(N, n) N m that friction laws (sim.effects.friction_law) add along a motion, from the load of the links alone."""
    nothing = by_stage((), arm)
    state = link_side(arm, motion, nothing)
    motor_side(state, nothing)
    state.tau[:] = 0.0
    for item in laws:
        effect_named(item.effect).apply(state, arm.joint_index(item.joint or ""), item.parameters)
    return state.tau


Stages = dict[Stage, list[tuple[Effect, int | None, ArmEffect]]]


def by_stage(effects: Iterable[ArmEffect], arm: Arm, law: Effect | None = None) -> Stages:
    """The effects sorted by stage, each with its joint's index; gains before offsets, widths after levels.

    law: replaces the effect of its name.
    """
    stages: Stages = {stage: [] for stage in Stage}
    for item in effects:
        effect = law if law is not None and law.name == item.effect else effect_named(item.effect)
        stages[effect.stage].append((effect, None if item.joint is None else arm.joint_index(item.joint), item))
    for items in stages.values():
        items.sort(key=lambda entry: _ORDER.get(entry[0].name, 0))
    return stages


# Within a stage the order matters twice: a reading is gain * torque + offset, and the width of slip follows from the whole level.
_ORDER = {"torque_offset": 1, "presliding_friction": 1}


def _run(state: PathState, stages: Stages, stage: Stage) -> None:
    for effect, joint, item in stages[stage]:
        effect.apply(state, joint, item.parameters)
