"""One log under one hypothesis: what the arm predicts, what is left, and how every uncertain number of the arm would move it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from calib.preprocessing import Measurement
from sim.arm import Arm, ArmEffect
from sim.effects import Stage, with_effect
from sim.effects.effect import PathState
from sim.prediction import SLIP_WIDTH, Stages, by_stage, link_side, motor_side
from sim.rigid_body import RigidBody, link_parameters

# How dry friction builds up is never in a model file: width around SLIP_WIDTH within a factor (e^0.7) and lead by some milliseconds.
WIDTH_SPREAD = 0.7
LEAD_SPREAD = 4e-3
# A drive that holds its torque between control instants leads its own reading by half a control period (1 ms at 500 Hz).
DELAY_MEAN, DELAY_SPREAD = -0.7e-3, 0.35e-3
# The dynamics of drives that nobody models act like a rotor inertia that is off by one factor on all joints.
ROTOR_TOGETHER = 0.3
CONTACT = "external_contact"
# Motors warm up; that much of all friction may go in a minute of work, or over the whole rise of the measured temperature.
WARMTH_SPREAD = 0.015
WARMING_SPREAD = 0.03
# Friction of an identified arm another day, relative; a stated default, as those of the prior.
DAY_TO_DAY = 0.05


@dataclass(frozen=True)
class Hypothesis:
    """An arm with the effects accepted so far, and how its dry friction builds up: width (n,) rad, lead (n,) s, delay s."""

    arm: Arm
    width: np.ndarray
    lead: np.ndarray
    delay: float = DELAY_MEAN
    accepted: tuple[ArmEffect, ...] = ()
    nominal_arm: Arm | None = None
    event_log: int | None = None

    @property
    def start(self) -> Arm:
        """The arm without any accepted effect."""
        return self.nominal_arm or self.arm

    def with_effects(self, accepted: tuple[ArmEffect, ...], event_log: int | None = None) -> Hypothesis:
        """The same dry friction and delay with other effects; an external contact belongs to one log only."""
        arm = self.start
        for item in accepted:
            if item.effect != CONTACT:
                arm = with_effect(arm, item)
        return replace(self, arm=arm, accepted=accepted, nominal_arm=self.start, event_log=event_log)

    def event(self, log: int) -> ArmEffect | None:
        """The contact that happened in that log, if any was accepted."""
        if log != self.event_log:
            return None
        return next((e for e in self.accepted if e.effect == CONTACT), None)

    @staticmethod
    def nominal(arm: Arm) -> Hypothesis:
        """Nothing accepted yet."""
        return Hypothesis(arm, np.full(arm.n, SLIP_WIDTH), np.full(arm.n, 3e-3))


class LogModel:
    """Prediction, residual rows (R, n) and nuisance rows (R, n, p) of one measurement under a hypothesis.

    `like`, a model of the same measurement, lends its rigid-body part where the hypothesis did not change it.
    """

    def __init__(
        self, measurement: Measurement, hypothesis: Hypothesis, event: ArmEffect | None = None, like: LogModel | None = None
    ) -> None:
        self.measurement, self.hypothesis = measurement, hypothesis
        arm = hypothesis.arm
        self.arm = arm
        effects = arm.effects if event is None else (*arm.effects, event)
        self.stages: Stages = by_stage(effects, arm)
        self.link: PathState
        self.bodies: RigidBody
        self.regressor: np.ndarray
        self.inertial: np.ndarray
        self.slopes: dict[int, list[np.ndarray]]  # of the rigid bodies by a joint's posture, filled when first asked for
        if like is not None and like.same_link(measurement, arm, self.stages):
            self.link, self.bodies, self.regressor, self.inertial = like.link, like.bodies, like.regressor, like.inertial
            self.slopes = like.slopes
        else:
            self.slopes = {}
            self.link = link_side(arm, measurement.trajectory, self.stages, measurement.warming)
            self.bodies = RigidBody(arm)
            self.regressor = self.bodies.regressor(self.link.q, self.link.dq, self.link.ddq)
            self.inertial = self._inertial()
        self.state = copied(self.link)
        motor_side(self.state, self.stages, hypothesis.width, hypothesis.lead)
        self.rate_of_change = self._gradient(self.state.tau)
        self.tau_hat = self.state.tau - hypothesis.delay * self.rate_of_change
        self.residual = measurement.rows(measurement.tau - self.tau_hat)
        self.nuisance, self.names = self._nuisance()

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

    def tail(self, j: int, own: list[ArmEffect], **changes: float) -> np.ndarray:
        """tau (N,) of joint j with `own` as its joint effects, from the present load; changes: width, lead."""
        state = one_joint(self.link, j)
        items = [replace(e, joint=self.arm.joint_names[0]) for e in own]
        stages = by_stage(items, self.arm)
        width = np.array([changes.get("width", self.hypothesis.width[j])])
        lead = np.array([changes.get("lead", self.hypothesis.lead[j])])
        motor_side(state, stages, width, lead)
        tau = state.tau[:, 0]
        return tau - self.hypothesis.delay * self._gradient(tau)

    def own_effects(self, j: int) -> list[ArmEffect]:
        """The effects of joint j after the link side, as the hypothesis has them."""
        late = (Stage.JOINT, Stage.TRANSMISSION, Stage.FRICTION, Stage.MOTOR, Stage.DRIVE, Stage.SENSOR)
        return [item for stage in late for _, joint, item in self.stages[stage] if joint == j]

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Filtered rows of samples."""
        return self.measurement.rows(x)

    def _gradient(self, x: np.ndarray) -> np.ndarray:
        t, starts = self.link.t, self.measurement.starts
        parts = [np.gradient(x[lo:hi], t[lo:hi], axis=0) for lo, hi in itertools.pairwise(starts)]
        return np.concatenate(parts)

    def _spread(self, j: int, effect: str, otherwise: float) -> float:
        """Relative standard deviation of an effect's one parameter: as identified, with what changes from day to day, else the prior's."""
        item = self.hypothesis.start.effect(effect, self.arm.joint_names[j])
        if item is None or not item.std:
            return otherwise
        (name, value), std = next(iter(item.parameters.items())), next(iter(item.std.values()))
        return min(otherwise, float(np.hypot(std / max(abs(value), 1e-12), DAY_TO_DAY))) if name in item.std else otherwise

    @property
    def own_spread(self) -> dict[tuple[str, str], float]:
        """(effect, joint) -> relative standard deviation of friction and rotors."""
        prior = self.arm.prior
        of = {"coulomb_friction": prior.coulomb, "viscous_friction": prior.viscous, "rotor_inertia": prior.rotor}
        return {(e, joint): self._spread(j, e, s) for e, s in of.items() for j, joint in enumerate(self.arm.joint_names)}

    def _warmth(self, j: int) -> np.ndarray:
        """(N,) share of friction lost, one standard deviation of the prior."""
        warming = self.measurement.warming
        return WARMTH_SPREAD * self.link.t / 60.0 if warming is None else WARMING_SPREAD * warming[:, j]

    def _inertial(self) -> np.ndarray:
        """(R, n, 5 n) N m per prior standard deviation of m, c and I of every link; a link moves no joint behind it."""
        prior, tree, n = self.arm.prior, self.arm.tree, self.arm.n
        pi = self.bodies.parameters()
        out = np.zeros((len(self.measurement.row_samples), n, 5 * n))
        for i in range(n):
            block = slice(10 * i, 10 * i + 10)
            size = max(float(np.linalg.norm(tree.com[i])), 0.005)
            step = 1e-6
            moves = [prior.mass * pi[block]]
            for axis in np.eye(3):
                moved = link_parameters(tree.mass[i], tree.com[i] + step * axis, tree.inertia[i])
                moves.append(prior.com * size * (moved - pi[block]) / step)
            moves.append(prior.inertia * link_parameters(0.0, tree.com[i], tree.inertia[i]))
            columns = self.regressor[:, : i + 1, block] @ np.stack(moves, axis=1)
            out[:, : i + 1, 5 * i : 5 * i + 5] = self.measurement.rows(columns)
        return out

    def _nuisance(self) -> tuple[np.ndarray, list[str]]:
        """(R, n, p) N m per prior standard deviation, and the parameters' names."""
        prior, n = self.arm.prior, self.arm.n
        names = [f"{what}_{i + 1}" for i in range(n) for what in ("m", "cx", "cy", "cz", "I")]
        own = [f"{what}_{j + 1}" for j in range(n) for what in ("Fc", "Fv", "Ia", "width", "lead", "warmth")]
        out = np.zeros((len(self.residual), n, len(names) + len(own) + 2))
        out[:, :, : 5 * n] = self.inertial
        together = np.zeros_like(self.tau_hat)
        for j in range(n):
            effects = self.own_effects(j)
            friction = self.state.warmth[:, j] * self.state.level[:, j] * self.state.slip[:, j]
            viscous = sum((e.parameters["viscous"] for e in effects if e.effect == "viscous_friction"), 0.0)
            rotor = sum((e.parameters["inertia"] for e in effects if e.effect == "rotor_inertia"), 0.0)
            speed, push = self.state.dq_motor[:, j], self.state.ddq_motor[:, j]
            base = self.tau_hat[:, j]
            wider = self.tail(j, effects, width=self.hypothesis.width[j] * 1.3)
            later = self.tail(j, effects, lead=self.hypothesis.lead[j] + 1e-3)
            columns = (
                self._spread(j, "coulomb_friction", prior.coulomb) * friction,
                self._spread(j, "viscous_friction", prior.viscous) * viscous * speed,
                self._spread(j, "rotor_inertia", prior.rotor) * rotor * push,
                WIDTH_SPREAD / np.log(1.3) * (wider - base),
                LEAD_SPREAD / 1e-3 * (later - base),
                -self._warmth(j) * (friction + viscous * speed),
            )
            first = 5 * n + 6 * j
            out[:, j, first : first + 6] = self.measurement.rows(np.stack(columns, axis=1))
            together[:, j] = ROTOR_TOGETHER * rotor * push
        out[:, :, -2] = self.measurement.rows(together)
        out[:, :, -1] = self.measurement.rows(-DELAY_SPREAD * self.rate_of_change)
        return out, [*names, *own, "Ia_all", "delay"]


def copied(state: PathState) -> PathState:
    """The same path in arrays of its own."""
    arrays = {k: np.array(v) for k, v in vars(state).items() if k != "warming"}
    return PathState(**arrays, warming=state.warming)


def one_joint(state: PathState, j: int) -> PathState:
    """The path of joint j alone, in arrays of its own."""
    own = {k: v[:, j : j + 1].copy() for k, v in vars(state).items() if k not in ("t", "force", "warming")}
    return PathState(
        **own, t=state.t, force=state.force, warming=None if state.warming is None else state.warming[:, j : j + 1]
    )


def recentred(hypothesis: Hypothesis, names: list[str], theta: np.ndarray) -> Hypothesis:
    """The hypothesis with width, lead and delay moved to where the fit puts them; the rest of the nuisance stays linear."""
    n = hypothesis.arm.n
    at = {name: k for k, name in enumerate(names)}
    width = hypothesis.width * np.exp(np.clip([WIDTH_SPREAD * theta[at[f"width_{j + 1}"]] for j in range(n)], -0.7, 0.7))
    lead = hypothesis.lead + np.clip([LEAD_SPREAD * theta[at[f"lead_{j + 1}"]] for j in range(n)], -4e-3, 4e-3)
    return replace(hypothesis, width=np.clip(width, 1e-5, 6e-4), lead=np.clip(lead, -5e-3, 2e-2))
