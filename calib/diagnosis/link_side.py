"""One measurement up to the load on the gears: motion of the links and columns of their inertial parameters."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.diagnosis.array_cache import MOTIONS, ArrayCache
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects.effect import Effect, Values
from sim.effects.friction_law import FrictionLaw
from sim.prediction import Stages, by_stage, dahl, gear_side, link_side
from sim.rigid_body import RigidBody, link_parameters
from sim.torque_path import PathState, Slip

AT_ONCE = 1000  # samples whose regressor is in memory before filtering
FRICTION_LAW = FrictionLaw()
# fields of a path that stages after the gear fill
FILLED = ("level", "width", "warmth", "slip", "tau")
# and those that hold motion and load of each joint
MOVES = ("q", "dq", "ddq", "load")


@dataclass(frozen=True)
class MotorMotion:
    """Motor motion and gear load of one joint after the effects at the joint and in its gear, (N, 1) each, read-only."""

    load: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    ddq_motor: np.ndarray

    @staticmethod
    def of(state: PathState) -> MotorMotion:
        """From the path of one joint."""
        motion = MotorMotion(state.load, state.q_motor, state.dq_motor, state.ddq_motor)
        for x in vars(motion).values():
            x.flags.writeable = False
        return motion


class JointSide:
    """Motion and load of one joint (N, 1), its inertial rows (R, 5 (n - j)) for the links from its own on, and caches.

    motions: of its motor, and their slips; paths: its torque under given effects; columns: of candidates there; whites: rows of
    all recordings after whitening, on the side of the first recording.
    """

    def __init__(self, path: PathState, inertial: np.ndarray, j: int) -> None:
        self.motion = {k: getattr(path, k)[:, j : j + 1] for k in MOVES}
        self.inertial = inertial
        self.motions = ArrayCache(MOTIONS)
        self.paths = ArrayCache()
        self.columns = ArrayCache()
        self.whites = ArrayCache()

    def same(self, path: PathState, inertial: np.ndarray, j: int) -> bool:
        """Whether joint j of that path has the same motion, load and inertial rows."""
        return all(np.array_equal(x[:, 0], getattr(path, k)[:, j]) for k, x in self.motion.items()) and np.array_equal(
            self.inertial, inertial
        )


class LinkSide:
    """One measurement up to the load on the gears: path, rigid-body columns, and what was computed from them so far.

    Models whose links move alike share it.
    like: of the same measurement. It lends motion and regressor if the links move alike, even with other masses, and the joints
    that other masses leave unchanged.
    kept: columns that depend on all joints.
    mass (n,): kg of the links without any accepted effect.
    """

    def __init__(
        self, measurement: Measurement, arm: Arm, stages: Stages, mass: np.ndarray, like: LinkSide | None = None
    ) -> None:
        self.measurement, self.arm = measurement, arm
        self.path: PathState = _up_to_the_load(link_side(arm, measurement.trajectory, stages, measurement.warming))
        self.bodies = RigidBody(arm)
        if like is not None and not (like.measurement is measurement and _move_alike(self, like)):
            like = None
        if like is not None:
            self.path = replace(self.path, q=like.path.q, dq=like.path.dq, ddq=like.path.ddq)
        self._regressors: ArrayCache = ArrayCache() if like is None else like._regressors
        rows = _inertial_rows(arm, self.regressor_rows, self.bodies.parameters(), mass)
        self.joints = [self._joint(like, rows[:, j, 5 * j :], j) for j in range(arm.n)]
        self.kept = ArrayCache()

    @property
    def regressor_rows(self) -> np.ndarray:
        """(R, n, 10 n) filtered rows of the links' regressor."""
        return np.asarray(self._regressors.of("rows", self._regressor_rows))

    def _regressor_rows(self) -> np.ndarray:
        m, path = self.measurement, self.path
        parts = [m.decimator.rows(self.bodies.regressor(path.q[b], path.dq[b], path.ddq[b])) for b in m.blocks(AT_ONCE)]
        return np.concatenate(parts)

    def _joint(self, like: LinkSide | None, inertial: np.ndarray, j: int) -> JointSide:
        if like is not None and like.joints[j].same(self.path, inertial, j):
            return like.joints[j]
        return JointSide(self.path, np.ascontiguousarray(inertial), j)

    @cached_property
    def largest_load(self) -> np.ndarray:
        """(n,) N m through the gears, exceeded in 1 % of the samples."""
        return np.asarray(np.quantile(np.abs(self.path.load), 0.99, axis=0))

    def joint(self, j: int, before: Sequence[ArmEffect], instead: Effect | None = None) -> PathState:
        """The path of joint j alone up to its gear, with effects `before`; arrays that later stages change are its own.

        instead: a law in place of one of them.
        """
        if instead is not None and any(e.effect == instead.name for e in before):
            return self._at_the_gear(j, before, instead)
        own = self.joints[j]
        if not before:
            return self._alone(j, own.motion | {f"{k}_motor": own.motion[k] for k in ("q", "dq", "ddq")})
        motor: MotorMotion = own.motions.of(("motor", *_key(before)), lambda: MotorMotion.of(self._at_the_gear(j, before)))
        return self._alone(j, own.motion | vars(motor))

    def slip(self, j: int, before: Sequence[ArmEffect]) -> Slip:
        """Dahl's law along the motion that the effects `before` leave; cached if the width is constant."""

        def known(state: PathState, joint: int, lead: float) -> np.ndarray:
            width = state.width[:, joint]
            if width.min() < width.max():
                return dahl(state, joint, lead)
            key = ("slip", float(width[0]), lead, *_key(before))
            return np.asarray(self.joints[j].motions.of(key, lambda: dahl(state, joint, lead)))

        return known

    def _at_the_gear(self, j: int, before: Sequence[ArmEffect], instead: Effect | None = None) -> PathState:
        motion = self.joints[j].motion
        moved = {k: np.empty_like(motion["q"]) for k in ("q_motor", "dq_motor", "ddq_motor")}
        state = self._alone(j, motion | moved | {"load": motion["load"].copy()})
        gear_side(state, by_stage(alone(before, self.arm), self.arm, instead))
        return state

    def _alone(self, j: int, motion: dict[str, np.ndarray]) -> PathState:
        """The path of joint j alone with this motion and load."""
        path = self.path
        blank = dict(zip(FILLED, np.zeros((len(FILLED), len(path.t), 1)), strict=True))
        blank["warmth"][:] = 1.0
        warming = None if path.warming is None else path.warming[:, j : j + 1]
        return PathState(**(blank | motion), t=path.t, force=path.force, warming=warming)

    def law(self, j: int, p: Values, before: Sequence[ArmEffect]) -> np.ndarray:
        """(N, 1) N m of a friction law of joint j, on the motion and load that the effects `before` it leave."""

        def torque() -> np.ndarray:
            state = self.joint(j, before)
            FRICTION_LAW.apply(state, 0, p)
            return state.tau

        found: np.ndarray = self.joints[j].columns.of(("law", *p.values(), *_key(before)), torque)
        return found

    def posture_slopes(self, j: int) -> np.ndarray:
        """(3, N, n) d tau / d q_j, d tau / d dq_j, d tau / d ddq_j of the bodies, by central differences (tau is quadratic in dq)."""
        found: np.ndarray = self.kept.of(("posture", j), lambda: self._posture_slopes(j))
        return found

    def _posture_slopes(self, j: int) -> np.ndarray:

        def torque(*steps: float) -> np.ndarray:
            moved = [self.path.q.copy(), self.path.dq.copy(), self.path.ddq.copy()]
            for x, step in zip(moved, steps, strict=True):
                x[:, j] += step
            return self.bodies.inverse_dynamics(*moved)

        by_angle = (torque(1e-3, 0, 0) - torque(-1e-3, 0, 0)) / 2e-3
        by_speed = (torque(0, 1e-2, 0) - torque(0, -1e-2, 0)) / 2e-2
        return np.stack([by_angle, by_speed, torque(0, 0, 1.0) - torque(0, 0, 0)])


def _up_to_the_load(path: PathState) -> PathState:
    """The same in contiguous, read-only columns, without memory for what later stages fill."""
    columns = {k: np.asfortranarray(getattr(path, k)) for k in MOVES}
    for x in columns.values():
        x.flags.writeable = False
    later = dict.fromkeys((*FILLED, "q_motor", "dq_motor", "ddq_motor"), np.broadcast_to(0.0, path.q.shape))
    return PathState(**(vars(path) | columns | later))


def alone(effects: Iterable[ArmEffect], arm: Arm) -> list[ArmEffect]:
    """The same effects at the first joint, as on a path of one joint."""
    return [ArmEffect(e.effect, arm.joint_names[0], e.parameters) for e in effects]


def _key(effects: Iterable[ArmEffect]) -> tuple[Hashable, ...]:
    return tuple((e.effect, *sorted(e.parameters.items())) for e in effects)


def centre_size(arm: Arm, i: int) -> float:
    """m: length of which prior.com is a share, for link i."""
    tree = arm.tree
    size = max(float(np.linalg.norm(tree.com[i])), 0.005)
    if arm.prior.numbers in ("guessed", "unknown"):
        size += float(np.sqrt(max(np.trace(tree.inertia[i]), 0.0) / max(tree.mass[i], 1e-9)))
    return size


def _move_alike(a: LinkSide, b: LinkSide) -> bool:
    """Whether two sides of one measurement have the same regressor: same joints, motion and gravity."""
    frame = ("parent", "rotation", "position", "axis", "prismatic", "gravity")
    trees, paths = (a.bodies.tree, b.bodies.tree), (a.path, b.path)
    return all(np.array_equal(*(getattr(x, k) for x in trees)) for k in frame) and all(
        np.array_equal(*(getattr(x, k) for x in paths)) for k in ("q", "dq", "ddq")
    )


def _inertial_rows(arm: Arm, regressor: np.ndarray, pi: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """(R, n, 5 n) N m per prior standard deviation of m, c and I of every link, from the regressor's rows.

    A link loads no joint after its own. The moments of what an effect adds to a link or removes from it are unknown: those of
    the link may follow its mass, or stay.
    """
    prior, tree, n = arm.prior, arm.tree, arm.n
    out = np.zeros((len(regressor), n, 5 * n))
    for i in range(n):
        block = slice(10 * i, 10 * i + 10)
        size, link = centre_size(arm, i), (tree.mass[i], tree.com[i], tree.inertia[i])
        moves = [prior.mass * pi[block]]
        for axis in np.eye(3):
            ahead, behind = (link_parameters(link[0], link[1] + way * axis, link[2]) for way in (1.0, -1.0))
            moves.append(prior.com * size * (ahead - behind) / 2)  # exact: quadratic in the centre
        changed = abs(mass[i] / link[0] - 1.0) if link[0] > 0 else 0.0
        moves.append(max(prior.inertia, changed) * link_parameters(0.0, *link[1:]))
        out[:, : i + 1, 5 * i : 5 * i + 5] = regressor[:, : i + 1, block] @ np.stack(moves, axis=1)
    return out
