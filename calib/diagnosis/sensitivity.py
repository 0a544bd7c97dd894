"""Sensitivity of the predicted torque to every fitted parameter, by finite differences along the exact torque path."""

from __future__ import annotations

import numpy as np

from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.model import LATE, LogModel
from calib.diagnosis.parameters import changed, logarithmic, parameters_of, within
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.effects.effect import Effect, Parameter
from sim.prediction import by_stage, link_side, motor_side


def columns_of(models: list[LogModel], hypothesis: Hypothesis) -> list[list[np.ndarray]]:
    """Per fitted parameter and log: change (R, n) of the predicted torque per fitting unit."""
    out = []
    for i, p in parameters_of(hypothesis.accepted):
        item = hypothesis.accepted[i]
        step = _step(item, p)
        if not within(changed(item, p, step)) or changed(item, p, step).parameters == item.parameters:
            step = -step
        moved = changed(item, p, step)
        out.append([_slope(model, hypothesis, k, item, moved, step) for k, model in enumerate(models)])
    return out


def other_law(model: LogModel, hypothesis: Hypothesis, log: int, item: ArmEffect, law: Effect) -> np.ndarray:
    """(R, n) change of predicted torque if `item`, an effect of the arm or a contact, follows `law` with its parameters."""
    if item.joint is None or effect_named(item.effect).stage not in LATE:
        event = hypothesis.event(log)
        tau = _predicted(model, hypothesis, hypothesis.arm, event, law)
        return model.rows(tau - model.tau_hat)
    j = model.arm.joint_index(item.joint)
    out = np.zeros_like(model.residual)
    out[:, j] = model.rows(model.tail(j, model.own_effects(j), law) - model.tau_hat[:, j])
    return out


def _step(item: ArmEffect, p: Parameter) -> float:
    if logarithmic(p):
        return 1e-2
    if p.zero is None:
        return 1e-3
    return max(1e-2 * abs(item.parameters[p.name] - p.zero), 1e-4 * abs(p.grid[0]))


def _slope(model: LogModel, hypothesis: Hypothesis, log: int, item: ArmEffect, moved: ArmEffect, step: float) -> np.ndarray:
    """(R, n) change of predicted torque per unit of the parameter that `moved` changes by `step`."""
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


def _predicted(
    model: LogModel, hypothesis: Hypothesis, arm: Arm, event: ArmEffect | None, law: Effect | None = None
) -> np.ndarray:
    effects = arm.effects if event is None else (*arm.effects, event)
    stages = by_stage(effects, arm, law)
    state = link_side(arm, model.measurement.trajectory, stages, model.measurement.warming)
    motor_side(state, stages, hypothesis.width, hypothesis.lead)
    return state.tau - hypothesis.delay * model.gradient(state.tau)
