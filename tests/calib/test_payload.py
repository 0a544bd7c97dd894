"""A load at the flange, from logs with and without it; with a known mass, also the torque constants."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.identification.base_fit import Options
from calib.identification.calibrated import write_calibrated
from calib.identification.consistency import pseudo_inertia
from calib.identification.identify import Identification
from calib.identification.loaded import identify_with_load
from calib.identification.payload import Load
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import AnswerIsNo, BadLog
from tests.calib.conftest import fourier_motion, recorded, varied

MASS, COM = 2.4, np.array([0.03, -0.02, 0.11])
OPTIONS = Options(slip_width=1e-4)


def carrying(arm: Arm, mass: float = MASS) -> Arm:
    return with_effect(
        arm, ArmEffect("payload", None, {"mass": mass, **dict(zip(("com_x", "com_y", "com_z"), COM, strict=True))})
    )


def logs_of(arm: Arm, seed: int) -> list[Log]:
    return [recorded(arm, fourier_motion(arm, k), seed + k) for k in (1, 2)]


def by_current(logs: list[Log], constant: np.ndarray) -> list[Log]:
    return [replace(log, current=log.tau / constant, tau=np.full_like(log.tau, np.nan)) for log in logs]


@pytest.fixture(scope="module")
def found() -> tuple[Identification, Load]:
    arm = load_arm("ur5e")
    truth = varied(arm, 4)
    return identify_with_load(arm, logs_of(truth, 10), logs_of(carrying(truth), 20), options=OPTIONS)


def test_mass_and_place_of_a_load_are_estimated(found: tuple[Identification, Load]) -> None:
    _, load = found
    assert abs(load.mass - MASS) < 3.5 * load.mass_std < 0.1
    assert np.all(np.abs(load.com - COM) < 3.5 * load.com_std)
    assert np.all(load.com_std < 0.003)
    assert load.chi2 < 2
    assert np.all(load.scale == 1)
    assert np.linalg.eigvalsh(load.inertia)[0] >= -1e-12


def test_the_result_states_the_load(found: tuple[Identification, Load]) -> None:
    result = found[0].result
    assert any("kg" in sentence and "last link" in sentence for sentence in result.findings)
    assert json.loads(json.dumps(result.as_dict()))["load"]["mass"]["unit"] == "kg"


def test_the_load_is_not_taken_for_a_part_of_the_arm(found: tuple[Identification, Load]) -> None:
    arm = found[0].arm
    truth = varied(load_arm("ur5e"), 4)
    assert abs(arm.tree.mass[3:].sum() - truth.tree.mass[3:].sum()) < 0.5 * MASS


def test_a_known_mass_gives_the_torque_constants(tmp_path: Path) -> None:
    nominal = load_arm("ur5e")
    truth = varied(nominal, 5)
    constant = np.array([10.5, 12.5, 9.0, 11.0, 9.8, 10.6])
    free, loaded = (by_current(logs_of(arm, seed), constant) for arm, seed in ((truth, 30), (carrying(truth), 40)))
    found, load = identify_with_load(nominal, free, loaded, options=OPTIONS, known_mass=MASS)
    assert load.mass == MASS
    assert load.mass_std == 0
    constants = found.arm.torque_constant
    assert constants is not None
    assert np.all(np.abs(constants - constant) < 4 * constant * load.scale_std / load.scale)
    assert np.all(np.abs(constants / constant - 1)[1:5] < 0.03)
    written = write_calibrated(tmp_path / "arm", nominal, found.arm)
    assert written.torque_constant is not None
    assert written.torque_constant.tolist() == constants.tolist()
    assert "2.4 kg at the flange" in written.provenance["torque_constant"]


@pytest.mark.slow
def test_an_arm_without_torque_constants_gets_them() -> None:
    nominal = replace(load_arm("ur5e"), torque_constant=None)
    constant = np.full(6, 11.0)
    free, loaded = (by_current(logs_of(arm, seed), constant) for arm, seed in ((nominal, 50), (carrying(nominal), 60)))
    found, load = identify_with_load(nominal, free, loaded, options=OPTIONS, known_mass=MASS)
    assert found.arm.torque_constant is not None
    assert np.all(np.abs(found.arm.torque_constant - 11.0) < 4 * 11.0 * load.scale_std / load.scale)


def test_a_joint_whose_torque_a_load_hardly_moves_is_named() -> None:
    nominal, mass = replace(load_arm("ur5e"), torque_constant=None), 0.15
    free, loaded = (
        by_current(logs_of(arm, seed)[:1], np.full(6, 11.0)) for arm, seed in ((nominal, 50), (carrying(nominal, mass), 60))
    )
    found, _ = identify_with_load(nominal, free, loaded, options=OPTIONS, known_mass=mass)
    unknown = [sentence for sentence in found.result.findings if "stays unknown" in sentence]
    assert len(unknown) == 1
    assert unknown[0].startswith("the torque constant of wrist_3_joint stays unknown")


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "message"), [(0.0, "may be nothing"), (-1.5, "wrong way round")])
def test_a_load_that_is_none_or_negative(mass: float, message: str) -> None:
    arm = load_arm("ur5e")
    free, loaded = (arm, arm) if mass == 0 else (carrying(arm, -mass), arm)
    with pytest.raises(AnswerIsNo, match=message):
        identify_with_load(arm, logs_of(free, 70), logs_of(loaded, 80), options=OPTIONS)


@pytest.mark.parametrize("mass", [0.0, -2.0, np.nan, np.inf])
def test_a_mass_that_is_none(mass: float) -> None:
    arm = load_arm("ur5e")
    with pytest.raises(AnswerIsNo, match="known mass"):
        identify_with_load(arm, logs_of(arm, 70)[:1], logs_of(carrying(arm), 80)[:1], options=OPTIONS, known_mass=mass)


def test_the_inertia_of_a_load_can_exist(found: tuple[Identification, Load]) -> None:
    _, load = found
    phi = np.concatenate([[load.mass], load.mass * load.com, np.zeros(6)])
    j = pseudo_inertia(phi)
    second = np.trace(load.inertia) / 2 * np.eye(3) - load.inertia
    j[:3, :3] = second + load.mass * np.outer(load.com, load.com)
    assert np.linalg.eigvalsh(j)[0] > -1e-9


def test_a_recording_has_no_load_beside_itself() -> None:
    arm = load_arm("ur5e")
    (log, *_) = logs_of(arm, 70)
    copied = replace(log, t=log.t + 5, q=np.round(log.q, 6))
    with pytest.raises(BadLog, match="the same recording"):
        identify_with_load(arm, [log], [copied], options=OPTIONS)
