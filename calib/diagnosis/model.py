"""One log under one hypothesis: prediction, residual, and how every uncertain parameter of the arm changes them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.link_side import LinkSide, alone
from calib.diagnosis.nuisance import (
    LATER,
    OWN,
    POSITIVE,
    WIDER,
    first_own,
    friction_lost,
    nuisance_names,
    nuisance_of_joint,
    own_columns,
    spreads,
    waves_of,
)
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects import Stage, effect_named
from sim.effects.effect import Effect
from sim.own_values import values_of
from sim.prediction import Stages, behind_the_gear, by_stage, dahl
from sim.rigid_body import RigidBody
from sim.torque_path import PathState
from sim.tree import KinematicTree

# stages after the load on the gear
LATE = (Stage.JOINT, Stage.TRANSMISSION, Stage.FRICTION, Stage.MOTOR, Stage.DRIVE, Stage.SENSOR)


@dataclass(frozen=True)
class JointPath:
    """Torque of one joint along the path, its rate of change (N,), and rows (R, k) of OWN, common reflected inertia and delay.

    tau_hat (N,) is shifted by the hypothesis's delay; residual (R,) N m.
    """

    key: Hashable
    tau_hat: np.ndarray
    rate: np.ndarray
    residual: np.ndarray
    nuisance: np.ndarray


class LogModel:
    """Prediction, residual rows (R, n) and nuisance rows per joint (R, q) of one measurement under a hypothesis.

    `like`, a model of the same measurement, lends its link side and its joints where the hypothesis leaves them unchanged.
    """

    def __init__(
        self, measurement: Measurement, hypothesis: Hypothesis, event: ArmEffect | None = None, like: LogModel | None = None
    ) -> None:
        self.measurement, self.hypothesis = measurement, hypothesis
        arm = self.arm = hypothesis.arm
        effects = arm.effects if event is None else (*arm.effects, event)
        self.stages: Stages = by_stage(effects, arm)
        lender = None if like is None else like.side
        if like is None or lender is None or not like.same_link(measurement, arm, self.stages):
            lender = LinkSide(measurement, arm, self.stages, hypothesis.start.tree.mass, lender)
        self.side: LinkSide = lender
        self.joints = [self._joint_path(j) for j in range(arm.n)]
        self.tau_hat = np.stack([x.tau_hat for x in self.joints], axis=1)
        self.residual = np.stack([x.residual for x in self.joints], axis=1)
        self.names = nuisance_names(arm.n)

    @property
    def link(self) -> PathState:
        """The path up to the load."""
        return self.side.path

    @property
    def tree(self) -> KinematicTree:
        """The arm's links."""
        return self.arm.tree

    @property
    def reading(self) -> np.ndarray:
        """(N, n) rad of the encoders."""
        return self.measurement.trajectory.q

    @property
    def starts(self) -> np.ndarray:
        """First sample of every stretch without a gap, and the number of samples."""
        return self.measurement.starts

    @property
    def bodies(self) -> RigidBody:
        """The rigid bodies of the hypothesis."""
        return self.side.bodies

    @property
    def regressor_rows(self) -> np.ndarray:
        """(R, n, 10 n) filtered rows of the links' regressor."""
        return self.side.regressor_rows

    @property
    def rate_of_change(self) -> np.ndarray:
        """(N, n) N m/s of the predicted torque."""
        return np.stack([x.rate for x in self.joints], axis=1)

    def same_link(self, measurement: Measurement, arm: Arm, stages: Stages) -> bool:
        """Whether the path up to the load is the same for that arm."""
        early = (Stage.ENCODER, Stage.RIGID, Stage.FORCE)
        return (
            measurement is self.measurement
            and arm.tree is self.arm.tree
            and all([x[2] for x in stages[s]] == [x[2] for x in self.stages[s]] for s in early)
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.arm.n

    @property
    def least(self) -> np.ndarray:
        """(p,) where friction and reflected inertia reach zero, in prior standard deviations; -inf for all others."""
        arm, of = self.arm, self._spreads
        out = np.full(len(self.names), -np.inf)
        for k, (effect, parameter, key) in enumerate(POSITIVE):
            for j, own in enumerate(values_of(arm, effect, parameter)):
                if of[key][j] > 0:
                    out[first_own(arm.n) + len(OWN) * j + k] = -own / of[key][j]
        return out

    @cached_property
    def _spreads(self) -> dict[str, np.ndarray]:
        return spreads(self.arm)

    def nuisance(self, j: int) -> np.ndarray:
        """(R, q) N m per prior standard deviation of parameters that affect joint j, in the order of `nuisance_of_joint`."""
        return np.concatenate([self.side.joints[j].inertial, self.joints[j].nuisance], axis=1)

    def nuisance_torque(self, j: int, theta: np.ndarray) -> np.ndarray:
        """(R,) N m of joint j from the nuisance theta (p,)."""
        return np.asarray(self.nuisance(j) @ theta[nuisance_of_joint(self.n, j)])

    def tail(self, j: int, own: Sequence[ArmEffect], instead: Effect | None = None, **changes: float) -> np.ndarray:
        """tau (N,) of joint j with effects `own` on the present load; instead: a law in place of one; changes: width, lead."""
        tau = self._state(j, own, instead, **changes).tau[:, 0]
        return tau - self.hypothesis.delay * self.gradient(tau)

    def own(self, effect: str, joint: int | None) -> Mapping[str, float] | None:
        """The parameters of an effect that the arm has, or None."""
        item = self.arm.effect(effect, None if joint is None else self.arm.joint_names[joint])
        return None if item is None else item.parameters

    def torque_with(self, j: int, effect: str, values: Mapping[str, float]) -> np.ndarray:
        """tau (N,) of joint j if it had that effect after the load, with these parameters."""
        others = [e for e in self.own_effects(j) if e.effect != effect]
        return self.tail(j, [*others, ArmEffect(effect, self.arm.joint_names[j], dict(values))])

    def posture_slopes(self, j: int) -> list[np.ndarray]:
        """d tau / d q_j, d tau / d dq_j, d tau / d ddq_j, each (N, n): of bodies, reflected inertia and viscous friction."""
        by_angle, by_speed, by_push = self.side.posture_slopes(j)
        own = []
        for name, key, slope in (("rotor_inertia", "inertia", by_push), ("viscous_friction", "viscous", by_speed)):
            item = self.own(name, j)
            own.append(slope.copy())
            if item is not None:
                own[-1][:, j] += item[key]
        return [by_angle, own[1], own[0]]

    def kept(self, key: Hashable, rows: Callable[[], np.ndarray]) -> np.ndarray:
        """Columns that depend on the path of all joints, from the cache or computed now."""
        return np.asarray(self.side.kept.of(key, rows))

    def kept_of(self, j: int, key: Hashable, rows: Callable[[], np.ndarray]) -> np.ndarray:
        """Columns that depend on the torque of joint j, from the cache or computed now."""
        return np.asarray(self.side.joints[j].columns.of((key, self.joint_key(j)), rows))

    def joint_state(self, j: int) -> PathState:
        """The path of joint j alone under the hypothesis, arrays (N, 1)."""
        return self._state(j, self.own_effects(j))

    def own_effects(self, j: int) -> list[ArmEffect]:
        """The effects of joint j after the link side, under the hypothesis."""
        return [item for stage in LATE for _, joint, item in self.stages[stage] if joint == j]

    def joint_key(self, j: int) -> Hashable:
        """What the torque of joint j depends on, besides its link side."""
        h = self.hypothesis
        items = [(e.effect, tuple(sorted(e.parameters.items()))) for e in (*self.own_effects(j), *self._channel())]
        return float(h.width[j]), float(h.lead[j]), h.delay, h.written, h.ripple_of(j), tuple(items)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Filtered rows of samples."""
        return self.measurement.rows(x)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """d x / dt of samples (N, ...), stretch by stretch."""
        return self.measurement.rate_of_change(x)

    def _channel(self) -> list[ArmEffect]:
        return [item for _, _, item in self.stages[Stage.CHANNEL]]

    def _state(self, j: int, own: Sequence[ArmEffect], instead: Effect | None = None, **changes: float) -> PathState:
        before = self._before_friction(own)
        state = self.side.joint(j, before, instead)
        law = next((e for e in own if e.effect == "friction_law"), None)
        if law is not None and instead is None and before == self._before_friction(self.own_effects(j)):
            # motion and load before the law are those of the hypothesis, so its torque is cached
            state.tau += self.side.law(j, law.parameters, before)
            own = [e for e in own if e is not law]
        width = np.array([changes.get("width", self.hypothesis.width[j])])
        lead = np.array([changes.get("lead", self.hypothesis.lead[j])])
        stages = by_stage([*alone(own, self.arm), *self._channel()], self.arm, instead)
        behind_the_gear(state, stages, width, lead, dahl if instead else self.side.slip(j, before))
        return state

    @staticmethod
    def _before_friction(own: Sequence[ArmEffect]) -> list[ArmEffect]:
        return [e for e in own if effect_named(e.effect).stage in (Stage.JOINT, Stage.TRANSMISSION)]

    def _joint_path(self, j: int) -> JointPath:
        key = self.joint_key(j)
        found: JointPath = self.side.joints[j].paths.of(key, lambda: self._joint_path_now(j, key))
        return found

    def _joint_path_now(self, j: int, key: Hashable) -> JointPath:
        own = self.own_effects(j)
        state = self._state(j, own)
        rate = self.gradient(state.tau[:, 0])
        tau_hat = state.tau[:, 0] - self.hypothesis.delay * rate
        spread = {key: values[j] for key, values in self._spreads.items()}
        wider = self.tail(j, own, width=self.hypothesis.width[j] * WIDER)
        later = self.tail(j, own, lead=self.hypothesis.lead[j] + LATER)
        lost, waves = self._friction_lost(j), waves_of(self.hypothesis.ripple_of(j), self.reading[:, j])
        changes = wider - tau_hat, later - tau_hat
        columns = own_columns(state, own, spread, rate, *changes, lost, self.hypothesis.written, waves)
        rows = self.rows(np.stack((*columns, self.measurement.tau[:, j] - tau_hat), axis=1))
        return JointPath(key, tau_hat, rate, rows[:, -1], rows[:, :-1])

    def _friction_lost(self, j: int) -> np.ndarray:
        warming = self.measurement.warming
        return friction_lost(self.link.t, None if warming is None else warming[:, j])
