"""A reading without the friction that the controller compensates is named; a reversed sign is not mistaken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded, varied
from calib.gate import gate
from logs.log import Log
from sim.arm import Arm, load_arm

NAME = "leaves out friction that the controller compensates"


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur5e")


@pytest.fixture(scope="module")
def log(arm: Arm) -> Log:
    return recorded(varied(arm, 5, 0.03), fourier_motion(arm, 60, seconds=8.0), 0)


@pytest.mark.parametrize(("joint", "added"), [(2, 60.0), (3, 6.0), (4, 20.0), (5, 6.0)])
def test_compensated_friction_is_named_first(arm: Arm, log: Log, joint: int, added: float) -> None:
    found = gate(arm, [replace(log, tau=log.tau - added * log.dq * (np.arange(6) == joint))])
    assert found.refusal is not None
    assert NAME in found.causes[0].sentence
    assert arm.joint_names[joint] in found.causes[0].sentence
    assert found.causes[0].corrections == ()
    assert "--assume sign" not in found.refusal


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("part", ["tau", "motion"])
def test_a_reversed_sign_is_no_compensated_friction(arm: Arm, log: Log, joint: int, part: str) -> None:
    sign = np.where(np.arange(6) == joint, -1.0, 1.0)
    turned = {"tau": log.tau * sign} if part == "tau" else {"q": log.q * sign, "dq": log.dq * sign}
    found = gate(arm, [replace(log, **turned)])
    assert not any(NAME in cause.sentence for cause in found.causes)
