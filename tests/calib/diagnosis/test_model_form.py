"""Standard deviations hold where a joint follows another published law of its effect than the catalogue's."""

from __future__ import annotations

import numpy as np
import pytest

from calib.diagnosis import selection
from calib.diagnosis.answer import entry
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.model import LogModel
from calib.diagnosis.model_form import form_std, with_shift
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.sensitivity import other_law
from sim.arm import Arm, ArmEffect
from sim.effects import EFFECTS, effect_named, with_effect
from sim.effects.effect import Effect
from sim.prediction import by_stage, link_side, motor_side
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import Hidden, recording
from tests.calib.diagnosis.test_every_effect import HIDDEN, JOINT

LAWS = [(e.name, law) for e in EFFECTS for law in e.forms()]
IDS = [f"{name}-{type(law).__name__.strip('_')}" for name, law in LAWS]


def item_of(effect: str) -> ArmEffect:
    return ArmEffect(effect, JOINT if effect_named(effect).scope == "joint" else None, dict(HIDDEN[effect]))


def under(arm: Arm, item: ArmEffect, law: Effect) -> Hidden:
    """Change that the effect makes if it follows `law`."""

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        def torque(effects: tuple[ArmEffect, ...]) -> np.ndarray:
            stages = by_stage(effects, arm, law)
            state = link_side(arm, motion, stages)
            motor_side(state, stages)
            return state.tau

        return torque((*arm.effects, item)) - torque(arm.effects)

    return hidden


def fitted(arm: Arm, item: ArmEffect, law: Effect) -> Fit:
    """Fit of the catalogue's effect to two recordings of an arm that follows `law`, starting from the true values."""
    here = under(arm, item, law)
    logs = [recording(arm, seed, None if item.effect == CONTACT and seed == 1 else here) for seed in (1, 2)]
    baseline = selection.started(warmed([measured(log, arm) for log in logs]), Hypothesis.nominal(arm))
    hypothesis = baseline.hypothesis.with_effects((item,), 1 if item.effect == CONTACT else None)
    recordings = [m.measurement for m in baseline.models]
    return fit(recordings, hypothesis, noise=baseline.solved.noise, like=baseline.models)


@pytest.mark.parametrize(("effect", "law"), LAWS, ids=IDS)
def test_a_joint_alone_follows_another_law_as_the_whole_path_does(ur10e: Arm, effect: str, law: Effect) -> None:
    """The path of one joint reuses earlier results, which must not contain anything that the other law changes."""
    item = item_of(effect)
    event = item if effect == CONTACT else None
    arm = ur10e if event else with_effect(ur10e, item)
    hypothesis = Hypothesis.nominal(arm).with_effects((item,) if event else (), 0 if event else None)
    model = LogModel(measured(recording(ur10e, 1, None), arm), hypothesis, event)
    stages = by_stage((*arm.effects, item) if event else arm.effects, arm, law)
    state = link_side(arm, model.measurement.trajectory, stages)
    motor_side(state, stages, hypothesis.width, hypothesis.lead)
    tau = state.tau - hypothesis.delay * model.gradient(state.tau)
    at = slice(None) if item.joint is None else arm.joint_index(item.joint)
    change = model.rows(tau - model.tau_hat)[:, at]
    assert np.abs(change).max() > 1e-6
    np.testing.assert_allclose(other_law(model, hypothesis, 0, item, law)[:, at], change, atol=1e-9 * np.abs(tau).max())


@pytest.mark.parametrize(("effect", "law"), LAWS, ids=IDS)
def test_the_interval_covers_another_law(ur10e: Arm, effect: str, law: Effect) -> None:
    """The dry friction of these recordings also has another form."""
    item = item_of(effect)
    found = fitted(ur10e, item, law)
    std, by_law = found.std()[0], form_std(found)[0]
    off = {k: (found.accepted[0].parameters[k] - v) / np.hypot(std[k], by_law[k]) for k, v in item.parameters.items()}
    assert all(abs(x) < 4 for x in off.values()), off
    assert any(by_law.values())


def test_every_law_has_the_effects_own_parameters_and_a_docstring() -> None:
    assert {name for name, _ in LAWS} >= {"stribeck_friction", "presliding_friction", "external_contact"}
    for name, law in LAWS:
        own = effect_named(name)
        assert law.parameters == own.parameters
        assert law.stage is own.stage
        assert law.law != own.law


def test_what_is_known_of_a_load_hardly_depends_on_the_law_of_friction(ur10e: Arm) -> None:
    found = fitted(ur10e, item_of("payload"), effect_named("payload"))
    std, by_law = found.std()[0], form_std(found)[0]
    assert all(0 < by_law[k] < std[k] for k in std)


def test_what_writing_moved_a_parameter_is_a_difference_between_laws() -> None:
    fitted, written = (ArmEffect("time_delay", None, {"delay": d}) for d in (6e-3, 4.5e-3))
    assert with_shift({"delay": 2e-3}, fitted, written) == pytest.approx({"delay": 2.5e-3})


def test_an_entry_holds_both_parts_of_a_standard_deviation(ur10e: Arm) -> None:
    item = item_of("load_dependent_friction")
    made = entry(ur10e, item, {"coefficient": 0.03}, 0.9, 1.0, by_law={"coefficient": 0.04})["parameters"]["coefficient"]
    assert (made["std"], made["std_by_law"]) == pytest.approx((0.05, 0.04))
    assert "std_by_law" not in entry(ur10e, item, {"coefficient": 0.03}, 0.9, 1.0)["parameters"]["coefficient"]
