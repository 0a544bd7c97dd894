"""Diagnosis of a long recording: sums do not depend on how pieces are joined, and every piece contributes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.diagnosis.answer import Diagnosis
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.parameters import parameters_of
from calib.diagnosis.sums import Point, Solver, others_of, portion
from calib.diagnosis.whole import Whole, diagnose_pieces, spread
from calib.regression.information import merged_joints
from calib.regression.noise import Noise
from calib.regression.stored import Kept
from logs import Pieces
from logs.log import Log
from sim.arm import Arm, ArmEffect
from tests.calib.diagnosis.conftest import at, recording

ELBOW, STIFFNESS = 2, 12.0
SPRING = at(ELBOW, lambda q, dq: STIFFNESS * (q - 0.4))


@pytest.fixture(scope="module")
def logs(ur10e: Arm) -> list[Log]:
    return [recording(ur10e, seed, SPRING, seconds=12.0) for seed in range(1, 5)]


@pytest.fixture(scope="module")
def asked(ur10e: Arm, logs: list[Log], tmp_path_factory: pytest.TempPathFactory) -> tuple[Diagnosis, Whole, Path]:
    folder = tmp_path_factory.mktemp("kept")
    found, whole = diagnose_pieces(ur10e, Pieces(*logs), [recording(ur10e, 9, SPRING)], Kept(folder), most=25.0)
    return found, whole, folder


def test_sums_do_not_depend_on_order_or_grouping(ur10e: Arm, logs: list[Log]) -> None:
    spring = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 10.0, "rest_angle": 0.3})
    noise = Noise(np.full(6, 2.0), np.full((6, 1), 0.3))
    point = Point(Hypothesis.nominal(ur10e).with_effects((spring,)), noise, None)
    parts = [portion(point, log) for log in logs]
    nuisance, named = len(point.model(logs[0]).names), len(parameters_of([spring]))
    whole = Solver(merged_joints(parts), nuisance, named)
    expected = whole.solution()
    assert expected.chi2 < expected.chi2_here
    others = [o for o in others_of(point, logs[3]) if o.effect in ("payload", "torque_gain", "base_tilt", "encoder_offset")]
    assert [o.columns for o in others] == [
        o.columns for o in others_of(point, logs[0]) if o in others or o.effect in {x.effect for x in others}
    ]
    ways = [parts[::-1], [merged_joints([parts[3], parts[1]]), merged_joints([parts[0], parts[2]])]]
    for way in ways:
        solver = Solver(merged_joints(way), nuisance, named)
        found = solver.solution()
        for mine, own in (
            (found.theta, expected.theta),
            (found.delta, expected.delta),
            (found.covariance, expected.covariance),
        ):
            assert np.abs(mine - own).max() < 1e-9 * np.abs(own).max()
        assert found.chi2 == pytest.approx(expected.chi2, rel=1e-9)
        for other in others:
            gain, item = solver.gain(other)
            same, twin = whole.gain(other)
            assert gain == pytest.approx(same, rel=1e-9)
            assert list(item.parameters.values()) == pytest.approx(list(twin.parameters.values()), rel=1e-8)


def test_every_piece_takes_part_in_the_answer(ur10e: Arm, asked: tuple[Diagnosis, Whole, Path], tmp_path: Path) -> None:
    found, whole, _ = asked
    assert whole.searched < 30
    assert whole.weighed == pytest.approx(48, abs=0.5)
    assert [(e["effect"], e["joint"]) for e in found.answer["effects"]] == [("joint_spring", "elbow_joint")]
    stiffness = found.answer["effects"][0]["parameters"]["stiffness"]
    assert stiffness["value"] == pytest.approx(STIFFNESS, rel=0.08)
    assert found.accepted[0].parameters["stiffness"] == stiffness["value"]
    before = found.found
    assert before is not None
    assert 0 < stiffness["std"] < before.best.std()[0]["stiffness"]
    gap = found.answer["gap"]
    assert gap["after"][ELBOW] < 0.7 * gap["before"][ELBOW]
    found.write(tmp_path, ur10e)
    assert (tmp_path / "arm" / "arm.toml").is_file()


@pytest.mark.slow
def test_pieces_that_are_done_are_not_done_again(ur10e: Arm, logs: list[Log], asked: tuple[Diagnosis, Whole, Path]) -> None:
    found, _, folder = asked
    files = sorted(folder.iterdir())
    assert len(files) > 0
    assert len(files) % len(logs) == 0
    stamps = [f.stat().st_mtime_ns for f in files]
    again, _ = diagnose_pieces(ur10e, Pieces(*logs), [recording(ur10e, 9, SPRING)], Kept(folder), most=25.0)
    assert again.answer == found.answer
    assert [f.stat().st_mtime_ns for f in files] == stamps
    # the stored sums are used
    for file in files:
        with np.load(file, allow_pickle=False) as stored:
            spoilt = {key: stored[key] for key in stored.files}
        spoilt["factor_2"] = spoilt["factor_2"] * 3.0
        np.savez(file, allow_pickle=False, **spoilt)
    other, _ = diagnose_pieces(ur10e, Pieces(*logs), [recording(ur10e, 9, SPRING)], Kept(folder), most=25.0)
    assert other.answer["effects"] != found.answer["effects"]


@pytest.mark.slow
def test_a_piece_that_was_not_searched_and_is_unlike_the_others_is_searched_too(ur10e: Arm) -> None:
    plain = [recording(ur10e, seed, seconds=12.0) for seed in range(1, 5)]
    chosen = spread([12.0] * 4, 25.0)
    other = next(k for k in range(4) if k not in chosen)
    plain[other] = recording(ur10e, 20, at(ELBOW, lambda q, dq: 40.0 * (q - 0.4)), seconds=12.0)
    found, whole = diagnose_pieces(ur10e, Pieces(*plain), most=25.0)
    assert whole.searched < 30
    assert ("joint_spring", "elbow_joint") in [(e["effect"], e["joint"]) for e in found.answer["effects"]] or found.answer[
        "unexplained"
    ]


@pytest.mark.slow
def test_an_arm_with_friction_laws_stays_as_it_was_tested(ur10e: Arm) -> None:
    """The elbow has a spring and friction that no single effect describes. Half of the recording is searched."""

    def both(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return (
            STIFFNESS * (q - 0.4) + 6.0 * np.tanh(dq / 0.02) * np.exp(-np.abs(dq) / 0.3) + 9.0 * np.sign(dq) * np.abs(dq) ** 0.4
        )

    logs = [recording(ur10e, seed, at(ELBOW, both), seconds=16.0) for seed in range(1, 7)]
    found, whole = diagnose_pieces(ur10e, Pieces(*logs[:5]), logs[5:], most=40.0)
    assert whole.searched < whole.weighed
    assert found.answer["laws"]
    assert found.correction is not None
    written = {e.joint: e.parameters for e in found.correction.effects if e.effect == "friction_law"}
    for law in found.answer["laws"]:
        assert law["parameters"] == {k: v for k, v in written[law["joint"]].items() if v}


@pytest.mark.slow
def test_a_short_recording_is_searched_whole(ur10e: Arm, logs: list[Log]) -> None:
    _, whole = diagnose_pieces(ur10e, Pieces(logs[0]), [logs[1]])
    assert whole.searched == whole.weighed == pytest.approx(12, abs=0.1)
    assert spread([120.0] * 30) == [7, 22]
    assert len(spread([120.0] * 30)) == 2
