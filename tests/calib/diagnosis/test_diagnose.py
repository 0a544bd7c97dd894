"""A hidden effect is named, nothing is named where none is hidden, and structure without a name is reported as unexplained."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import evidence
from calib.diagnosis import selection
from calib.diagnosis.answer import Diagnosis
from calib.diagnosis.contact import contacts
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.prices import price
from calib.diagnosis.scoring import Bank, scored
from calib.report.diagnosis import write as write_page
from sim.arm import Arm, load_arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import Hidden, at, recording

ELBOW = 2


def asked(arm: Arm, hidden: Hidden | None = None, truth: Arm | None = None) -> Diagnosis:
    logs = [recording(arm, seed, hidden, truth) for seed in (1, 2, 3)]
    return diagnose(arm, logs[:2], logs[2:])


def names(found: Diagnosis) -> list[tuple[str, str | None]]:
    return [(e["effect"], e["joint"]) for e in found.answer["effects"]]


def test_where_nothing_is_hidden_nothing_is_found(ur10e: Arm) -> None:
    found = asked(ur10e)
    assert found.answer["verdict"] == "no_missing_effect"
    assert found.answer["effects"] == []
    assert found.answer["unexplained"] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "parameter", "value", "hidden"),
    [
        ("joint_spring", "stiffness", 12.0, at(ELBOW, lambda q, dq: 12.0 * (q - 0.4))),
    ],
)
def test_a_hidden_torque_gets_its_name(ur10e: Arm, effect: str, parameter: str, value: float, hidden: Hidden) -> None:
    found = asked(ur10e, hidden)
    assert found.answer["verdict"] == "effects_found"
    assert names(found) == [(effect, "elbow_joint")]
    entry = found.answer["effects"][0]["parameters"][parameter]
    assert entry["nominal"] == 0.0
    assert found.answer["effects"][0]["parameters"]["rest_angle"]["nominal"] is None
    assert entry["value"] == pytest.approx(value, rel=0.15)
    assert 0 < entry["std"] < 0.3 * value
    gap = found.answer["gap"]
    assert gap["after"][ELBOW] < 0.6 * gap["before"][ELBOW]
    assert gap["after"][ELBOW] < 0.8 * gap["refit"][ELBOW]


def loaded(arm: Arm, mass: float, com: np.ndarray) -> Arm:
    tree = arm.tree
    whole, centre = tree.mass.copy(), tree.com.copy()
    whole[5] += mass
    centre[5] = (tree.mass[5] * tree.com[5] + mass * com) / whole[5]
    return replace(arm, tree=replace(tree, mass=whole, com=centre))


def test_a_payload_is_named_with_its_mass_and_the_corrected_arm_carries_it(ur10e: Arm, tmp_path: Path) -> None:
    mass = 2.0
    found = asked(ur10e, truth=loaded(ur10e, mass, np.array([0.0, 0.02, 0.1])))
    assert names(found) == [("payload", None)]
    assert found.answer["effects"][0]["parameters"]["mass"]["value"] == pytest.approx(mass, rel=0.08)
    found.write(tmp_path, ur10e)
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == found.answer
    still = np.zeros((1, 6))
    torque = RigidBody(load_arm(tmp_path / "arm")).inverse_dynamics(still, still, still)
    assert abs(torque[0, 1]) > abs(RigidBody(ur10e).inverse_dynamics(still, still, still)[0, 1]) + 15.0


@pytest.mark.slow
def test_a_name_that_came_first_gives_way_to_the_right_one(ur10e: Arm) -> None:
    truth = loaded(ur10e, 2.0, np.array([0.0, 0.02, 0.1]))
    logs = warmed(
        [measured(recording(ur10e, seed, at(ELBOW, lambda q, dq: 12.0 * (q - 0.4)), truth), ur10e) for seed in (1, 2)]
    )
    first = selection.started(logs, Hypothesis.nominal(ur10e))
    link = next(s for s in scored(first) if s.key == ("link_inertia", "wrist_2_joint"))
    second = selection.add(logs, first, link)
    spring = next(s for s in scored(second) if s.key == ("joint_spring", "elbow_joint"))
    ended = selection.exchanged(logs, selection.add(logs, second, spring), Bank(), set())
    assert {(e.effect, e.joint) for e in ended.accepted} == {("payload", None), ("joint_spring", "elbow_joint")}


@pytest.mark.parametrize("drag", [3.0, pytest.param(14.0, marks=pytest.mark.slow)])
def test_what_has_no_name_in_the_catalogue_is_said_to_have_none(ur10e: Arm, drag: float) -> None:
    def drag_of_a_neighbour(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        out[:, ELBOW] = drag * np.tanh(motion.dq[:, 3] / 0.3)
        return out

    found = asked(ur10e, drag_of_a_neighbour)
    assert found.answer["verdict"] == "unexplained"
    assert [u["joint"] for u in found.answer["unexplained"]] == ["elbow_joint"]
    assert "dq:wrist_1_joint" in found.answer["unexplained"][0]["depends_on"]
    assert found.answer["unexplained"][0]["rms"] > 0.2 * drag
    assert names(found) == []


@pytest.mark.slow
def test_what_is_most_of_a_joints_structure_is_named_beside_what_has_no_name(ur10e: Arm) -> None:
    def spring_and_drag(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        out[:, ELBOW] = 12.0 * (motion.q[:, ELBOW] - 0.4) + 13.0 * np.tanh(motion.dq[:, 3] / 0.3)
        return out

    found = asked(ur10e, spring_and_drag)
    assert found.answer["verdict"] == "unexplained"
    assert [u["joint"] for u in found.answer["unexplained"]] == ["elbow_joint"]
    assert names(found) == [("joint_spring", "elbow_joint")]
    assert found.answer["effects"][0]["parameters"]["stiffness"]["value"] == pytest.approx(12.0, rel=0.15)


def test_what_the_model_lacks_is_no_noise(ur10e: Arm) -> None:
    """A strong spring outside the model leaves many times the noise. The noise estimate must still be the recording's own."""
    shares = []
    for hidden in (None, at(ELBOW, lambda q, dq: 40.0 * (q - 0.4))):
        logs = [recording(ur10e, seed, hidden) for seed in (1, 2)]
        f = selection.started(warmed([measured(log, ur10e) for log in logs]), Hypothesis.nominal(ur10e))
        left = float(np.sqrt(np.mean(f.solved.residuals()[ELBOW] ** 2)))
        # the noise of these recordings is proportional to the joint's largest torque
        largest = max(float(np.abs(log.tau[:, ELBOW]).max()) for log in logs)
        shares.append((f.solved.noise.sigma[ELBOW] / largest, left / largest))
    (clean, _), (springy, left) = shares
    assert left > 5 * springy
    assert springy == pytest.approx(clean, rel=0.25)


@pytest.mark.slow
def test_a_recording_too_short_to_measure_noise_has_no_floor(ur10e: Arm, tmp_path: Path) -> None:
    """With too few rows for a noise model beside the ordinary parameters, the floor would contain the arm's own error."""
    log = recording(ur10e, 1, seconds=6.0)
    found = diagnose(ur10e, [log])
    assert found.answer["gap"]["noise_floor"] == []
    assert found.answer["noise_source"] is None
    page = write_page(tmp_path / "report.html", found.answer, evidence.of_diagnosis(ur10e, ur10e, log, found), ur10e)
    assert "not measured" in page.read_text(encoding="utf-8")
    longer = diagnose(ur10e, [recording(ur10e, seed) for seed in (1, 2)])
    assert len(longer.answer["gap"]["noise_floor"]) == ur10e.n
    assert longer.answer["noise_source"]


@pytest.mark.slow
def test_a_push_is_found_in_time_and_not_written_into_the_arm(ur10e: Arm, tmp_path: Path) -> None:
    def pushed(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        window = np.clip(1 - np.abs(motion.t - 7.0) / 0.6, 0, None)  # a triangle
        linear, _ = RigidBody(ur10e).jacobian(motion.q)
        return -np.einsum("kcj,c->kj", linear, np.array([25.0, -20.0, 30.0])) * window[:, None]

    logs = [recording(ur10e, 1), recording(ur10e, 2, pushed), recording(ur10e, 3)]
    found = diagnose(ur10e, logs[:2], logs[2:])
    assert names(found) == [("external_contact", None)]
    push = found.answer["effects"][0]["parameters"]
    assert push["start"]["value"] + push["duration"]["value"] / 2 == pytest.approx(7.0, abs=0.15)
    found.write(tmp_path, ur10e)
    # a friction law, which describes reversals, may be written
    assert [e.effect for e in load_arm(tmp_path / "arm").effects if e.effect != "friction_law"] == [
        e.effect for e in ur10e.effects
    ]


def test_a_burst_while_one_joint_moves_is_no_push(ur10e: Arm) -> None:
    def burst(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        out = np.zeros_like(tau)
        out[:, ELBOW] = 30.0 * np.clip(1 - np.abs(motion.t - 7.0) / 0.6, 0, None)
        return out

    logs = [recording(ur10e, 1, burst, only=ELBOW), recording(ur10e, 2)]
    f = selection.started(warmed([measured(log, ur10e) for log in logs]), Hypothesis.nominal(ur10e))
    windows = list(contacts(f.solved, ur10e))
    assert {log for log, *_ in windows} == {1}
    assert all(gain < price(item) for _, gain, item, _ in windows)


@pytest.mark.parametrize(("factor", "check"), [(-1.0, "torque"), (101.0, "size")])
def test_a_wrong_sign_or_unit_is_a_fault_of_the_recording(ur10e: Arm, factor: float, check: str) -> None:
    logs = [recording(ur10e, seed) for seed in (1, 2)]
    wrong = [replace(log, tau=log.tau * np.where(np.arange(6) == 1, factor, 1.0)) for log in logs]
    found = diagnose(ur10e, wrong)
    assert found.answer["verdict"] == "bad_data"
    assert found.answer["arm_out"] is None  # an arm folder beside it would be mistaken for a corrected arm
    assert [c["check"] for c in found.answer["data_checks"] if not c["ok"]] == [check]
    assert found.answer["effects"] == []


def test_a_frozen_joint_and_speed_in_degrees_are_faults_of_the_recording(ur10e: Arm) -> None:
    log = recording(ur10e, 1)
    q, tau = log.q.copy(), log.tau.copy()
    q[500:700, 1], tau[500:700, 1] = q[500, 1], tau[500, 1]
    failed = [c for c in diagnose(ur10e, [replace(log, q=q, tau=tau)]).answer["data_checks"] if not c["ok"]]
    assert "frozen joints" in [c["check"] for c in failed]
    assert "shoulder_lift_joint" in next(c["detail"] for c in failed if c["check"] == "frozen joints")
    degrees = replace(log, dq=np.degrees(log.dq))
    assert [c["check"] for c in diagnose(ur10e, [degrees]).answer["data_checks"] if not c["ok"]] == ["speed"]
