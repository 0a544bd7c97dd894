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
DELAY_MEAN, DELAY_SPREAD = -0.75e-3, 0.3e-3
# The dynamics of drives that nobody models act like a rotor inertia that is off by one factor on all joints.
ROTOR_TOGETHER = 0.3
CONTACT = "external_contact"
# Motors warm up; that much of all friction may go with every ten degrees.
WARMTH_SPREAD = 0.015


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
    """Prediction, residual rows (R, n) and nuisance rows (R, n, p) of one measurement under a hypothesis."""

    def __init__(self, measurement: Measurement, hypothesis: Hypothesis, event: ArmEffect | None = None) -> None:
        self.measurement, self.hypothesis = measurement, hypothesis
        arm = hypothesis.arm
        self.arm = arm
        effects = arm.effects if event is None else (*arm.effects, event)
        self.stages: Stages = by_stage(effects, arm)
        self.link = link_side(arm, measurement.trajectory, self.stages)
        self.state = copied(self.link)
        motor_side(self.state, self.stages, hypothesis.width, hypothesis.lead)
        self.rate_of_change = self._gradient(self.state.tau)
        self.tau_hat = self.state.tau - hypothesis.delay * self.rate_of_change
        self.residual = measurement.rows(measurement.tau - self.tau_hat)
        self.bodies = RigidBody(arm)
        self.regressor = self.bodies.regressor(self.link.q, self.link.dq, self.link.ddq)
        columns, self.names = self._nuisance()
        self.nuisance = measurement.rows(columns)

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

    def _nuisance(self) -> tuple[np.ndarray, list[str]]:
        """(N, n, p) N m per prior standard deviation."""
        prior, tree, n = self.arm.prior, self.arm.tree, self.arm.n
        samples = len(self.link.t)
        columns: list[np.ndarray] = []
        names: list[str] = []
        y, pi = self.regressor, self.bodies.parameters()
        for i in range(n):
            part = y[:, :, 10 * i : 10 * i + 10]
            columns.append(prior.mass * (part @ pi[10 * i : 10 * i + 10]))
            names.append(f"m_{i + 1}")
            size = max(float(np.linalg.norm(tree.com[i])), 0.005)
            for axis, letter in zip(np.eye(3), "xyz", strict=True):
                step = 1e-6
                moved = link_parameters(tree.mass[i], tree.com[i] + step * axis, tree.inertia[i])
                columns.append(prior.com * size * (part @ ((moved - pi[10 * i : 10 * i + 10]) / step)))
                names.append(f"c{letter}_{i + 1}")
            columns.append(prior.inertia * (part @ link_parameters(0.0, tree.com[i], tree.inertia[i])))
            names.append(f"I_{i + 1}")
        heat = np.nan_to_num(self.link.t / 60.0)
        for j in range(n):
            own = self.own_effects(j)
            friction = self.state.warmth[:, j] * self.state.level[:, j] * self.state.slip[:, j]
            viscous = sum((e.parameters["viscous"] for e in own if e.effect == "viscous_friction"), 0.0)
            rotor = sum((e.parameters["inertia"] for e in own if e.effect == "rotor_inertia"), 0.0)
            speed, push = self.state.dq_motor[:, j], self.state.ddq_motor[:, j]
            base = self.tau_hat[:, j]
            wider = self.tail(j, own, width=self.hypothesis.width[j] * 1.3)
            later = self.tail(j, own, lead=self.hypothesis.lead[j] + 1e-3)
            for name, column in (
                ("Fc", prior.coulomb * friction),
                ("Fv", prior.viscous * viscous * speed),
                ("Ia", prior.rotor * rotor * push),
                ("width", WIDTH_SPREAD / np.log(1.3) * (wider - base)),
                ("lead", LEAD_SPREAD / 1e-3 * (later - base)),
                ("warmth", -WARMTH_SPREAD * heat * (friction + viscous * speed)),
            ):
                whole = np.zeros((samples, n))
                whole[:, j] = column
                columns.append(whole)
                names.append(f"{name}_{j + 1}")
        together = np.zeros((samples, n))
        for j in range(n):
            rotor = sum((e.parameters["inertia"] for e in self.own_effects(j) if e.effect == "rotor_inertia"), 0.0)
            together[:, j] = ROTOR_TOGETHER * rotor * self.state.ddq_motor[:, j]
        columns.append(together)
        names.append("Ia_all")
        columns.append(-DELAY_SPREAD * self.rate_of_change)
        names.append("delay")
        return np.stack(columns, axis=2), names


def copied(state: PathState) -> PathState:
    """The same path in arrays of its own."""
    return PathState(**{k: np.array(v) for k, v in vars(state).items()})


def one_joint(state: PathState, j: int) -> PathState:
    """The path of joint j alone, in arrays of its own."""
    return PathState(**{k: np.array(v) if k in ("t", "force") else v[:, j : j + 1].copy() for k, v in vars(state).items()})


def recentred(hypothesis: Hypothesis, names: list[str], theta: np.ndarray) -> Hypothesis:
    """The hypothesis with width, lead and delay moved to where the fit puts them; the rest of the nuisance stays linear."""
    n = hypothesis.arm.n
    at = {name: k for k, name in enumerate(names)}
    width = hypothesis.width * np.exp(np.clip([WIDTH_SPREAD * theta[at[f"width_{j + 1}"]] for j in range(n)], -0.7, 0.7))
    lead = hypothesis.lead + np.clip([LEAD_SPREAD * theta[at[f"lead_{j + 1}"]] for j in range(n)], -4e-3, 4e-3)
    return replace(hypothesis, width=np.clip(width, 1e-5, 6e-4), lead=np.clip(lead, -5e-3, 2e-2))
