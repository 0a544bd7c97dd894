"""A motion separates two explanations by torque that neither a rival nor a refit can imitate."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.known_truth import HOME, fourier_motion
from calib.excitation.design import coarse
from calib.excitation.discriminate import discriminating, pairs_of, separation
from calib.excitation.fourier import Basis
from calib.excitation.home import open_cell
from calib.excitation.room import Room
from sim.arm import Arm, ArmEffect
from sim.errors import AnswerIsNo, ConfigError

ELBOW = "elbow_joint"
OFFSET = ArmEffect("torque_offset", ELBOW, {"offset": 4.0})
SPRING = ArmEffect("joint_spring", ELBOW, {"stiffness": 8.0, "rest_angle": 1.0})


def diagnosis(folder: Path, effect: ArmEffect, *rivals: tuple[str, str | None]) -> Path:
    parameters = {k: {"value": v, "std": 0.1, "nominal": 0.0, "unit": ""} for k, v in effect.parameters.items()}
    entry = {
        "effect": effect.effect,
        "joint": effect.joint,
        "parameters": parameters,
        "indistinguishable_from": [{"effect": e, "joint": j} for e, j in rivals],
    }
    folder.mkdir(exist_ok=True)
    (folder / "diagnosis.json").write_text(json.dumps({"effects": [entry]}))
    return folder


def test_nothing_parts_an_effect_from_itself(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1, 10.0, 20.0)
    alone = separation(ur5e, motion, OFFSET, ("torque_offset", ELBOW))
    assert alone < 1e-6
    assert separation(ur5e, motion, OFFSET, ("joint_spring", "wrist_1_joint")) > 5.0


def test_no_motion_is_planned_for_effects_that_are_one_on_every_motion(ur5e: Arm) -> None:
    room, pairs = Room(ur5e, open_cell(ur5e)), [(SPRING, ("torque_offset", ELBOW)), (OFFSET, ("torque_offset", ELBOW))]
    with pytest.raises(AnswerIsNo, match="separates torque offset at elbow_joint and torque offset at elbow_joint") as error:
        discriminating(room, pairs, Basis(5, 10.0), HOME, np.random.default_rng(3), 2)
    assert "decide by other means: static holds" in str(error.value)


def test_what_a_refit_can_imitate_is_not_counted(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1, 10.0, 20.0)
    coulomb = ArmEffect("coulomb_friction", ELBOW, {"coulomb": 9.0})
    assert separation(ur5e, motion, coulomb, ("torque_offset", ELBOW)) < 0.2 * separation(
        ur5e, motion, SPRING, ("torque_offset", ELBOW)
    )


def test_the_chosen_motion_parts_more_than_the_first_that_fits(ur5e: Arm) -> None:
    room, pairs, basis = Room(ur5e, open_cell(ur5e)), [(SPRING, ("torque_offset", ELBOW))], Basis(5, 10.0)
    _, first = discriminating(room, pairs, basis, HOME, np.random.default_rng(3), 1, iterations=0)
    _, best = discriminating(room, pairs, basis, HOME, np.random.default_rng(3), 6, iterations=0)
    assert best >= first > 1.0


@pytest.mark.slow
def test_an_ascent_parts_more_than_where_it_began_and_keeps_the_limits(ur5e: Arm) -> None:
    room, pairs, basis = Room(ur5e, open_cell(ur5e)), [(SPRING, ("torque_offset", ELBOW))], Basis(4, 10.0)
    _, first = discriminating(room, pairs, basis, HOME, np.random.default_rng(3), 1, iterations=0)
    found, best = discriminating(room, pairs, basis, HOME, np.random.default_rng(3), 1, iterations=8)
    assert first > 1.0  # below that, the comparison would be of rounding errors
    assert best > 1.2 * first
    assert room.use(coarse(found)).fits
    assert separation(ur5e, coarse(found), *pairs[0]) == pytest.approx(best)


def test_a_diagnosis_without_rivals_or_of_another_arm_is_refused(ur5e: Arm, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nothing to discriminate"):
        pairs_of(diagnosis(tmp_path / "a", OFFSET), ur5e)
    with pytest.raises(ConfigError, match="joint"):
        pairs_of(diagnosis(tmp_path / "b", OFFSET, ("joint_spring", "elbo_joint")), ur5e)
    with pytest.raises(ConfigError, match="cannot be read"):
        pairs_of(tmp_path / "nowhere", ur5e)
