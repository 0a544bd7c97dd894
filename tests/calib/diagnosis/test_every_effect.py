"""Every effect of the catalogue is found first by the search when hidden in short recordings with another friction law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis import selection
from calib.diagnosis.acceptance import APART
from calib.diagnosis.admissible import admissible
from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.prices import cost
from calib.diagnosis.scoring import scored
from sim.arm import Arm, ArmEffect
from sim.effects import EFFECTS, Stage, effect_named, with_effect
from sim.prediction import by_stage, link_side, predict
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import Hidden, recording

JOINT = "elbow_joint"
# Hidden values, large enough to show in half a minute at ten times the torque noise of a good drive.
HIDDEN = {
    "coulomb_friction": {"coulomb": 14.0},
    "viscous_friction": {"viscous": 16.0},
    "asymmetric_friction": {"half_difference": 3.0},
    "stribeck_friction": {"stiction_excess": 9.0, "stribeck_velocity": 0.2},
    "nonlinear_viscous_friction": {"coefficient": 9.0, "exponent": 2.4},
    "load_dependent_friction": {"coefficient": 0.1},
    "thermal_friction": {"relative_drop": 0.5, "time_constant": 12.0},
    "presliding_friction": {"stiffness": 150.0},
    "rotor_inertia": {"inertia": 5.5},
    "joint_elasticity": {"stiffness": 700.0},
    "backlash": {"half_gap": 0.006},
    "torque_ripple": {"amplitude": 4.0, "cycles": 4.0, "phase": 0.7},
    "joint_spring": {"stiffness": 12.0, "rest_angle": 0.4},
    "torque_gain": {"gain": 1.15},
    "torque_offset": {"offset": 4.0},
    "torque_saturation": {"limit": 55.0},
    "encoder_offset": {"offset": 0.05},
    "encoder_eccentricity": {"amplitude": 0.03, "cycles": 2.0, "phase": 0.5},
    "time_delay": {"delay": 0.008},
    "payload": {"mass": 2.0, "com_x": 0.02, "com_y": 0.0, "com_z": 0.1},
    "link_inertia": {"mass": 6.5, "com_x": -0.27, "com_y": 0.0, "com_z": 0.06},
    "base_tilt": {"roll": 0.05, "pitch": -0.04},
    "tool_force": {"force_x": 12.0, "force_y": -8.0, "force_z": 5.0},
    "transmission_coupling": {"ratio": 1.0, "inertia": 1.2, "viscous": 6.0, "coulomb": 6.0},
    CONTACT: {"start": 6.0, "duration": 1.2, "force_x": 30.0, "force_y": -25.0, "force_z": 30.0},
}


def hidden_by(arm: Arm, item: ArmEffect) -> Hidden:
    """Change that the effect makes: to the reading if it acts on the reading, otherwise to the predicted torque."""
    effect = effect_named(item.effect)

    def hidden(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        if effect.stage < Stage.DRIVE:
            return predict(with_effect(arm, item), motion) - predict(arm, motion)
        state = link_side(arm, motion, by_stage((), arm))
        state.tau = tau.copy()
        effect.apply(state, None if item.joint is None else arm.joint_index(item.joint), item.parameters)
        return state.tau - tau

    return hidden


@pytest.fixture(scope="module")
def calibrated(ur10e: Arm) -> Arm:
    """An arm with measured friction and reflected inertia, so that an ordinary refit does not absorb the hidden effect."""
    return replace(ur10e, prior=ur10e.prior.model_copy(update={"coulomb": 0.04, "viscous": 0.04, "rotor": 0.04}))


def test_every_effect_has_a_case() -> None:
    assert set(HIDDEN) == {e.name for e in EFFECTS if e.name != "friction_law"}


@pytest.mark.parametrize("effect", HIDDEN)
def test_an_effect_is_the_first_to_be_named(calibrated: Arm, effect: str) -> None:
    """Or it is within APART of the first: from one motion an offset and an asymmetry, for example, are nearly the same."""
    arm = calibrated
    item = ArmEffect(effect, JOINT if effect_named(effect).scope == "joint" else None, dict(HIDDEN[effect]))
    logs = [recording(arm, seed, None if effect == CONTACT and seed == 1 else hidden_by(arm, item)) for seed in (1, 2)]
    baseline = selection.started(warmed([measured(log, arm) for log in logs]), Hypothesis.nominal(arm))
    fitted = [m.measurement for m in baseline.models]
    ranked = scored(baseline)[: selection.TRIED]
    fits = [f for f in (selection.add(fitted, baseline, s) for s in ranked) if admissible(f)]
    assert fits, [(s.key, round(s.gain)) for s in ranked]
    least = min(map(cost, fits))
    assert least < cost(baseline)
    found = [f for f in fits if cost(f) < least + APART and (f.accepted[0].effect, f.accepted[0].joint) == (effect, item.joint)]
    assert found, [(f.accepted, round(cost(f) - least)) for f in fits]
    name, value = next(iter(item.parameters.items()))
    assert abs(found[0].accepted[0].parameters[name] - value) < max(0.3 * abs(value), 5 * found[0].std()[0][name])
