"""Accepted effects, nuisance and noise fitted together: Gauss-Newton on the exact torque path, all logs at once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.contact import force_spread
from calib.diagnosis.hypothesis import CONTACT, Hypothesis, recentred
from calib.diagnosis.model import LATE, LogModel
from calib.diagnosis.rows import ORDER, ResidualRows, Solved, solve
from calib.measurement.preprocessing import Measurement
from calib.regression.noise import Noise, noise_of
from calib.regression.robust import huber
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.effects.effect import Parameter
from sim.errors import ConfigError
from sim.prediction import by_stage, link_side, motor_side


@dataclass
class Fit:
    """A fitted hypothesis.

    joint        the nuisance with the accepted parameters free beside it
    objective    -2 log likelihood with the noise's own scale, and the prior's share; lower is better
    covariance   (k, k) of the accepted parameters in the order of `parameters_of`, in fitting units
    """

    hypothesis: Hypothesis
    models: list[LogModel]
    solved: Solved
    joint: Solved
    objective: float
    covariance: np.ndarray

    @property
    def accepted(self) -> tuple[ArmEffect, ...]:
        """The effects of the hypothesis."""
        return self.hypothesis.accepted

    def std(self) -> list[dict[str, float]]:
        """Standard deviation of every parameter of every accepted effect, 0 where it was chosen and not fitted."""
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        out = [dict.fromkeys(e.parameters, 0.0) for e in self.accepted]
        for (i, p), s in zip(parameters_of(self.accepted), deviation, strict=True):
            value = self.accepted[i].parameters[p.name]
            out[i][p.name] = float(s * abs(value)) if logarithmic(p) else float(s)
        return out


def fit(
    measurements: Sequence[Measurement],
    hypothesis: Hypothesis,
    rounds: int = 5,
    noise: Noise | None = None,
    like: Sequence[LogModel] = (),
    touched: Collection[int] | None = None,
) -> Fit:
    """Fit the accepted effects' parameters from where they stand; at most `rounds` steps.

    noise: of the recordings; None takes the residuals' own, which is right only for a first guess. like: models of the same
    measurements, whose parts are taken over where they hold. touched: joints whose dry friction builds up anew (None: all).
    """
    joints = range(hypothesis.arm.n) if touched is None else touched
    guess = noise is None
    at = _Point.at(measurements, hypothesis, noise, like)
    for _ in range(rounds):
        step = at.step(joints)
        if guess:
            at = _Point.at(measurements, step(1.0), None, at.models)
            continue
        for share in SHARES:
            there = _Point.at(measurements, step(share), at.noise, at.models)
            if there.objective < at.objective:
                break
        else:
            break
        gained, at = at.objective - there.objective, there
        if gained < SETTLED:
            break
    return at.fit()


SHARES, SETTLED = (1.0, 0.3, 0.1), 1.0


@dataclass
class _Point:
    """A hypothesis with its rows, the nuisance fitted beside it, and how its accepted parameters change the torque."""

    hypothesis: Hypothesis
    models: list[LogModel]
    noise: Noise
    rows: ResidualRows
    solved: Solved
    objective: float
    _joint: tuple[Solved, np.ndarray] | None = None

    @staticmethod
    def at(
        measurements: Sequence[Measurement], hypothesis: Hypothesis, noise: Noise | None, like: Sequence[LogModel]
    ) -> _Point:
        lenders = like or (None,) * len(measurements)
        pairs = zip(measurements, lenders, strict=True)
        models = [LogModel(m, hypothesis, hypothesis.event(i), lender) for i, (m, lender) in enumerate(pairs)]
        rows = ResidualRows(models)
        if noise is None:
            noise = noise_of(solve(rows, noise_of(rows.r, rows.joined, ORDER)).residuals(), rows.joined, ORDER)
        solved = solve(rows, noise)
        return _Point(hypothesis, models, noise, rows, solved, objective(solved))

    def joint(self) -> tuple[Solved, np.ndarray]:
        """The fit with the accepted parameters free as well, and their scales (k,)."""
        if self._joint is None:
            columns = columns_of(self.models, self.hypothesis)
            scales = _scales(columns, self.hypothesis)
            solved = solve(_joined(self.rows, columns, self.hypothesis), self.noise) if columns else self.solved
            self._joint = solved, scales
        return self._joint

    def step(self, joints: Collection[int]) -> Callable[[float], Hypothesis]:
        """Share of the Gauss-Newton step -> hypothesis; dry friction of `joints` builds up anew."""
        joint, scales = self.joint()
        p = self.rows.p

        def moved_by(share: float) -> Hypothesis:
            there = recentred(self.hypothesis, self.models[0].names, share * joint.theta[:p], joints)
            return moved(there, share * joint.theta[p:] * scales) if len(scales) else there

        return moved_by

    def fit(self) -> Fit:
        """What is known at this point."""
        joint, scales = self.joint()
        p = self.rows.p
        covariance = joint.inverse[p:, p:] * np.outer(scales, scales)
        return Fit(self.hypothesis, self.models, self.solved, joint, self.objective, covariance)


WIDE = 1e3  # prior standard deviation of an accepted parameter, in columns of unit whitened size


def objective(solved: Solved) -> float:
    """-2 log likelihood (Huber's loss) of all rows under the noise, but for a constant, plus the prior's share."""
    total = sum(huber(e) for e in solved.left())
    off = solved.theta - solved.rows.mean
    return float(total + off @ off)


def parameters_of(accepted: Sequence[ArmEffect]) -> list[tuple[int, Parameter]]:
    """(index of the effect, parameter) of everything that is fitted."""
    return [
        (i, p)
        for i, item in enumerate(accepted)
        for p in effect_named(item.effect).parameters
        if not p.chosen(item.parameters[p.name])
    ]


def nominal_values(arm: Arm, item: ArmEffect) -> dict[str, float | None]:
    """What the arm has in the place of an effect: its own values, else those at which the effect vanishes, None for a shape."""
    own = arm.effect(item.effect, item.joint)
    if item.effect == "link_inertia" and item.joint is not None:
        j = arm.joint_index(item.joint)
        return dict(zip(("mass", "com_x", "com_y", "com_z"), map(float, (arm.tree.mass[j], *arm.tree.com[j])), strict=True))
    return dict(own.parameters) if own else {p.name: p.zero for p in effect_named(item.effect).parameters}


def logarithmic(p: Parameter) -> bool:
    """Scales without a zero are fitted as logarithms."""
    return p.zero is None and p.lower > 0


def within(item: ArmEffect) -> bool:
    """Whether every parameter is finite and inside its physical bounds."""
    bounds = {p.name: p for p in effect_named(item.effect).parameters}
    return all(np.isfinite(v) and bounds[k].lower <= v <= bounds[k].upper for k, v in item.parameters.items())


def _step(item: ArmEffect, p: Parameter) -> float:
    if logarithmic(p):
        return 1e-2
    if p.zero is None:
        return 1e-3
    return max(1e-2 * abs(item.parameters[p.name] - p.zero), 1e-4 * abs(p.grid[0]))


def _changed(item: ArmEffect, p: Parameter, by: float) -> ArmEffect:
    value = item.parameters[p.name]
    value = value * float(np.exp(np.clip(by, -1.0, 1.0))) if logarithmic(p) else value + by
    return replace(item, parameters=dict(item.parameters) | {p.name: float(np.clip(value, p.lower, p.upper))})


def columns_of(models: list[LogModel], hypothesis: Hypothesis) -> list[tuple[float, list[np.ndarray]]]:
    """Per fitted parameter: its step, and per log the change (R, n) of predicted torque per unit of it."""
    out = []
    for i, p in parameters_of(hypothesis.accepted):
        item = hypothesis.accepted[i]
        step = _step(item, p)
        if not within(_changed(item, p, step)) or _changed(item, p, step).parameters == item.parameters:
            step = -step
        moved = _changed(item, p, step)
        out.append((step, [_slope(model, hypothesis, k, item, moved, step) for k, model in enumerate(models)]))
    return out


def _slope(model: LogModel, hypothesis: Hypothesis, log: int, item: ArmEffect, moved: ArmEffect, step: float) -> np.ndarray:
    """(R, n) change of predicted torque per unit of the parameter that `moved` has changed by `step`."""
    if effect_named(item.effect).stage not in LATE or item.joint is None:
        return model.rows(_difference(model, hypothesis, log, item, moved)) / step
    j = model.arm.joint_index(item.joint)
    key = ("slope", item.effect, tuple(moved.parameters.items()))

    def rows() -> np.ndarray:
        own = [moved if e.effect == item.effect else e for e in model.own_effects(j)]
        return np.asarray(model.rows(model.tail(j, own) - model.tau_hat[:, j]) / step)

    out = np.zeros_like(model.residual)
    out[:, j] = model.kept_of(j, key, rows)
    return out


def _difference(model: LogModel, hypothesis: Hypothesis, log: int, item: ArmEffect, moved: ArmEffect) -> np.ndarray:
    """Change of the predicted torque (N, n) when one accepted effect changes."""
    out = np.zeros_like(model.tau_hat)
    if item.effect == CONTACT:
        if hypothesis.event_log != log:
            return out
        return _predicted(model, hypothesis, hypothesis.arm, moved) - model.tau_hat
    accepted = tuple(moved if e is item else e for e in hypothesis.accepted)
    arm = hypothesis.start
    for e in accepted:
        if e.effect != CONTACT:
            arm = with_effect(arm, e)
    return _predicted(model, hypothesis, arm, hypothesis.event(log)) - model.tau_hat


def _predicted(model: LogModel, hypothesis: Hypothesis, arm: Arm, event: ArmEffect | None) -> np.ndarray:
    effects = arm.effects if event is None else (*arm.effects, event)
    stages = by_stage(effects, arm)
    state = link_side(arm, model.measurement.trajectory, stages, model.measurement.warming)
    motor_side(state, stages, hypothesis.width, hypothesis.lead)
    return state.tau - hypothesis.delay * model.gradient(state.tau)


def _scales(columns: list[tuple[float, list[np.ndarray]]], hypothesis: Hypothesis) -> np.ndarray:
    """(k,) prior standard deviation of every accepted parameter: WIDE over its column's size, or its own, or that of a contact's force."""
    sizes = [np.sqrt(sum(float((c**2).sum()) for c in per_log)) for _, per_log in columns]
    wide = [WIDE / s if s > 0 else 0.0 for s in sizes]
    spread = force_spread(hypothesis.arm)
    of = parameters_of(hypothesis.accepted)
    return np.array([
        spread if _is_push(hypothesis.accepted[i], p) else min(w, p.spread) for (i, p), w in zip(of, wide, strict=True)
    ])  # fmt: skip


def _is_push(item: ArmEffect, p: Parameter) -> bool:
    return item.effect == CONTACT and p.name.startswith("force")


def _joined(rows: ResidualRows, columns: list[tuple[float, list[np.ndarray]]], hypothesis: Hypothesis) -> ResidualRows:
    """The rows with the accepted parameters' columns behind the nuisance, scaled to their priors."""
    if not columns:
        return rows
    widened = ResidualRows(rows.models)
    scale = _scales(columns, hypothesis)
    for j in range(rows.n):
        extra = [rows.take(j, [c[:, j] for c in per_log]) for _, per_log in columns]
        widened.x[j] = np.concatenate([rows.x[j], np.stack(extra, axis=1) * scale], axis=1)
    # Columns are changes from where the parameters stand, so the middle of a contact's prior, no force, lies at minus the force.
    mean = np.zeros(len(columns))
    for k, (i, p) in enumerate(parameters_of(hypothesis.accepted)):
        item = hypothesis.accepted[i]
        if _is_push(item, p):
            mean[k] = -item.parameters[p.name] / scale[k]
    widened.mean = np.concatenate([rows.mean, mean])
    widened.least = np.concatenate([rows.least, np.full(len(columns), -np.inf)])
    return widened


def moved(hypothesis: Hypothesis, change: np.ndarray) -> Hypothesis:
    """The hypothesis with its accepted parameters moved by `change` (k,) in fitting units, kept inside their bounds."""
    accepted = list(hypothesis.accepted)
    for (i, p), by in zip(parameters_of(hypothesis.accepted), change, strict=True):
        accepted[i] = _changed(accepted[i], p, float(by))
    try:
        return hypothesis.with_effects(tuple(accepted), hypothesis.event_log)
    except ConfigError:
        return hypothesis
