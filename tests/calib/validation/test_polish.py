"""Polish removes excess friction of the simulated arm, and changes nothing that does not improve unseen motion."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import main as program
from calib.measurement.preprocessing import Measurement, prepare
from calib.validation.forward import forward_error
from calib.validation.polish import HORIZON, POLISHED, polish, shots_of, with_corrections
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import BadLog, ConfigError
from tests.calib.conftest import fourier_motion, recorded

SECONDS = 8.0


def log_of(arm: Arm, seed: int) -> Log:
    return recorded(arm, fourier_motion(arm, seed, seconds=SECONDS), noise=0.2)


@pytest.fixture(scope="module")
def logs(ur5e: Arm) -> list[Log]:
    return [log_of(ur5e, seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def recordings(ur5e: Arm, logs: list[Log]) -> list[Measurement]:
    return [prepare(log, ur5e) for log in logs]


def stiffer(arm: Arm, share: float) -> Arm:
    """The arm with more dry and viscous friction at two joints."""
    for joint in arm.joint_names[1:3]:
        for effect in ("coulomb_friction", "viscous_friction"):
            own = arm.effect(effect, joint)
            assert own is not None
            arm = with_effect(arm, ArmEffect(effect, joint, {POLISHED[effect]: (1 + share) * own.parameters[POLISHED[effect]]}))
    return arm


def test_slopes_of_the_errors_are_those_of_the_simulation(ur5e: Arm, recordings: list[Measurement]) -> None:
    """To first order and with smoothed friction, the slopes predict how a correction moves the ends of the windows."""
    joint = ur5e.joint_names[1]
    shots = shots_of(ur5e, recordings[0], [("viscous_friction", joint)])
    assert len(shots.errors) > 10
    own = ur5e.effect("viscous_friction", joint)
    assert own is not None
    step = 0.2 * own.parameters["viscous"]
    more = with_effect(ur5e, ArmEffect("viscous_friction", joint, {"viscous": own.parameters["viscous"] + step}))
    expected = np.sqrt(np.mean((shots.slopes[:, 1, 0] * step) ** 2))
    moved = forward_error(more, recordings[0], HORIZON).angle[1]
    assert moved == pytest.approx(expected, rel=0.5)


def test_too_much_friction_is_taken_off(ur5e: Arm, recordings: list[Measurement]) -> None:
    wrong = stiffer(ur5e, 0.3)
    found = polish(wrong, recordings[:2], recordings[2:])
    assert found.accepted
    assert np.sqrt(np.mean(found.after**2)) < 0.6 * np.sqrt(np.mean(found.before**2))
    for key, change in zip(found.keys, found.theta, strict=True):
        if key[0] == "viscous_friction" and key[1] in ur5e.joint_names[1:3]:
            assert change < 0
    np.testing.assert_allclose(forward_error(found.arm, recordings[2], HORIZON).angle, found.after)
    assert "before the corrections" in found.sentence


def test_what_does_not_help_unseen_motion_is_refused(ur5e: Arm, recordings: list[Measurement]) -> None:
    """The fitted recordings have 50 % more friction at two joints than the held-out one."""
    misleading = [prepare(log_of(stiffer(ur5e, 0.5), seed), ur5e) for seed in (1, 2)]
    found = polish(ur5e, misleading, recordings[2:])
    assert not found.accepted
    assert found.arm is ur5e
    assert found.sentence.endswith("are refused")


def test_no_correction_leaves_the_bounds_of_its_parameter(ur5e: Arm) -> None:
    keys = [(e, j) for e in ("coulomb_friction", "viscous_friction") for j in ur5e.joint_names]
    changed = with_corrections(ur5e, keys, np.full(len(keys), -1e3))
    assert {e.parameters[POLISHED[e.effect]] for e in changed.effects if e.effect in POLISHED} == {0.0}


def test_corrections_that_are_not_numbers_are_refused(
    ur5e: Arm, recordings: list[Measurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.validation.polish._solved", lambda shots, ridge: np.full(shots[0].slopes.shape[2], np.nan))
    monkeypatch.setattr("calib.validation.polish.with_corrections", lambda arm, keys, theta: arm)
    angles = iter((0.1, np.nan, np.inf, np.nan))
    monkeypatch.setattr("calib.validation.polish._simulated", lambda arm, held: np.full(6, next(angles)))
    found = polish(ur5e, recordings[:2], recordings[2:])
    assert not found.accepted
    assert not found.theta.any()
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["after_rad"] == [None] * 6
    assert "unstable" in found.sentence


def test_an_arm_without_friction_and_recordings_at_rest_are_refused(ur5e: Arm, recordings: list[Measurement]) -> None:
    bare = replace(ur5e, effects=tuple(e for e in ur5e.effects if e.effect not in POLISHED))
    with pytest.raises(ConfigError, match="calib identify first"):
        polish(bare, recordings[:1], recordings[1:])
    still = replace(recordings[0], usable=np.zeros_like(recordings[0].usable))
    for fit, held in (([still], recordings[:1]), (recordings[:1], [still])):
        with pytest.raises(BadLog, match="every joint moves"):
            polish(ur5e, fit, held)


def test_the_command_writes_an_arm_only_where_it_moves_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ur10e = load_arm("ur10e")
    names = {kind: [f"{kind}{seed}.csv" for seed in (1, 2, 3)] for kind in ("right", "stiff")}
    for truth, kind in ((ur10e, "right"), (stiffer(ur10e, 0.5), "stiff")):
        for seed, name in enumerate(names[kind], start=1):
            write_csv(log_of(truth, seed), ur10e, Path(name))
    assert program.main(["polish", "ur10e", *names["stiff"][:2], "--holdout", names["stiff"][2], "--out", "better"]) == 0
    answer = json.loads(Path("better/polish.json").read_text())
    assert answer["schema"] == "polish/1"
    assert np.mean(answer["after_rad"]) < np.mean(answer["before_rad"])
    by = {(c["effect"], c["joint"]): c["change"] for c in answer["corrections"]}
    written, joint = load_arm("better/arm"), ur10e.joint_names[1]
    before, after = (arm.effect("viscous_friction", joint) for arm in (ur10e, written))
    assert before is not None
    assert after is not None
    change = by["viscous_friction", joint]
    assert change > 0
    assert after.parameters["viscous"] == pytest.approx(before.parameters["viscous"] + change)
    assert program.main(["polish", "ur10e", *names["stiff"][:2], "--holdout", names["right"][2], "--out", "worse"]) == 1
    assert not Path("worse/arm").exists()
    assert program.main(["polish", "ur10e", names["stiff"][0]]) == 2
    assert program.main(["polish", "ur10e", names["stiff"][0], "--holdout", names["stiff"][0]]) == 2


def write_csv(log: Log, arm: Arm, file: Path) -> None:
    """Write the log as a UR recorder does."""
    assert log.q is not None
    heads = [f"actual_{kind}_{j}" for kind in ("q", "qd", "current") for j in range(arm.n)]
    rows = np.column_stack([log.t, log.q, log.dq, log.tau / arm.torque_constant])
    np.savetxt(file, rows, delimiter=",", header=",".join(["timestamp", *heads]), comments="", fmt="%.17g")


def test_the_file_holds_what_was_applied_and_not_what_was_asked_for(
    ur5e: Arm, recordings: list[Measurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.validation.polish._solved", lambda shots, ridge: np.full(shots[0].slopes.shape[2], -1e3))
    found = polish(ur5e, recordings[:2], recordings[2:])
    for one in found.as_dict()["corrections"]:
        if one["effect"] in ("coulomb_friction", "viscous_friction"):
            own = ur5e.effect(one["effect"], one["joint"])
            assert own is not None
            assert one["change"] == pytest.approx(-own.parameters[one["parameter"]])
