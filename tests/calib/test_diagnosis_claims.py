"""Each sentence of a diagnosis is a claim, checked against diagnosis.json, the written arm and the recordings."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.claims import SENTENCES
from calib.claims.of_diagnosis import FAR, VERDICT, claims, verdict
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.motion import measured
from calib.diagnosis.written_arm import torque_rms
from calib.report.diagnosis import next_steps, remarks, sentence
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.effects.friction_law import formula
from tests.calib.conftest import fourier_motion, recorded
from tests.calib.report import examples

SPRING = ArmEffect("joint_spring", "elbow_joint", {"stiffness": 3.0, "rest_angle": 0.3})
MISREAD = -np.eye(6)[3] * 2 + 1


@dataclass(frozen=True)
class Written:
    """A diagnosis as written to disk: the answer, the arm folder and its recordings."""

    nominal: Arm
    answer: dict[str, Any]
    arm: Arm
    logs: list[Log]

    def claim(self, name: str) -> dict[str, Any] | None:
        return next((c for c in self.answer["claims"] if c["claim"] == name), None)


def written(folder: Path, nominal: Arm, logs: list[Log]) -> Written:
    diagnose(nominal, logs[:1], logs[1:]).write(folder, nominal)
    answer = json.loads((folder / "diagnosis.json").read_text())
    return Written(nominal, answer, load_arm(str(folder / "arm")) if answer["arm_out"] else nominal, logs)


@pytest.fixture(scope="module")
def nominal() -> Arm:
    return load_arm("servo6")


@pytest.fixture(scope="module")
def logs(nominal: Arm) -> list[Log]:
    truth = with_effect(nominal, SPRING)
    return [recorded(truth, fourier_motion(nominal, 81 + k, 10.0, 100.0), k, memory=0.0) for k in range(2)]


@pytest.fixture(scope="module")
def spring(tmp_path_factory: pytest.TempPathFactory, nominal: Arm, logs: list[Log]) -> Written:
    return written(tmp_path_factory.mktemp("spring"), nominal, logs)


def test_every_sentence_is_a_claim_and_follows_from_its_numbers(spring: Written) -> None:
    made = claims(spring.answer)
    assert [c.as_dict() for c in made] == spring.answer["claims"]
    assert made[0].name in VERDICT
    assert sum(c.name in VERDICT for c in made) == 1
    text = " ".join([sentence(spring.answer), *next_steps(spring.answer)])
    assert [c.sentence for c in made if c.sentence not in text] == []


def test_what_is_missing_is_in_the_arm_that_was_written(spring: Written) -> None:
    claim = spring.claim("missing") or spring.claim("unexplained")
    assert claim is not None
    assert ("joint_spring", "elbow_joint") in {(e["effect"], e["joint"]) for e in claim["effects"]}
    for e in claim["effects"]:
        own = spring.arm.effect(e["effect"], e["joint"])
        assert own is not None
        for name, p in e["parameters"].items():
            assert abs(own.parameters[name] - p["value"]) < 3 * p["std"] + 1e-9
        assert spring.nominal.effect(e["effect"], e["joint"]) is None
        assert 0 < e["gap_share"] <= 1
        j, gap = spring.answer["gap"]["joints"].index(e["joint"]), spring.answer["gap"]
        assert (e["residual"]["before"], e["residual"]["after"]) == (gap["before"][j], gap["after"][j])


def test_the_residual_that_was_removed_is_that_of_the_arms_on_the_recording(spring: Written) -> None:
    claim = spring.claim("removed")
    assert claim is not None
    j = spring.nominal.joint_index(claim["joint"])
    held_out = [measured(spring.logs[1], spring.nominal)]
    assert claim["after"] == pytest.approx(torque_rms(spring.arm, held_out)[j], rel=1e-6)
    assert claim["before"] == pytest.approx(torque_rms(spring.nominal, held_out)[j], rel=1e-6)
    shares = np.array(spring.answer["gap"]["after"]) / np.array(spring.answer["gap"]["before"])
    assert claim["after"] / claim["before"] == pytest.approx(shares.min())


def test_the_simulated_motion_is_that_of_the_answer(spring: Written) -> None:
    claim, pairs = spring.claim("motion"), spring.answer["motion"]
    assert (claim is None) == (not pairs)
    if claim is not None:
        longest = max(pairs, key=lambda p: p["after"]["horizon_s"])
        assert claim["horizon_s"] == longest["after"]["horizon_s"]
        assert (claim["before"], claim["after"]) == (longest["before"]["flange_m"], longest["after"]["flange_m"])
        assert claim["after"] < claim["before"]


def test_what_is_refused_is_not_in_the_arm_and_laws_are(spring: Written) -> None:
    for c in spring.answer["claims"]:
        if c["claim"] == "refused":
            effect, _, joint = c["text"].partition(" was fitted")[0].partition(" at ")
            assert spring.arm.effect(effect, joint or None) is None
        if c["claim"] == "law":
            own = spring.arm.effect("friction_law", c["joint"])
            assert own is not None
            assert formula(own.parameters) == c["formula"]
    held = {e.joint for e in spring.arm.effects if e.effect == "friction_law"}
    assert held == {c["joint"] for c in spring.answer["claims"] if c["claim"] == "law"}


def test_recordings_that_cannot_be_used_claim_their_causes_and_nothing_else(
    tmp_path: Path, nominal: Arm, logs: list[Log]
) -> None:
    wrong = [replace(log, tau=log.tau * MISREAD) for log in logs]
    found = written(tmp_path, nominal, wrong)
    (claim,) = found.answer["claims"]
    failed = [c["detail"] for c in found.answer["data_checks"] if not c["ok"]]
    assert claim["claim"] == "bad_data"
    assert claim["failed"] == failed
    assert failed
    assert all(text in claim["sentence"] for text in failed)
    assert found.answer["arm_out"] is None
    assert not list(tmp_path.rglob("arm.toml"))


def test_what_the_arm_folder_holds_is_said_where_it_is_another_number(spring: Written) -> None:
    (effect,) = [e for e in spring.answer["effects"] if e["effect"] == "joint_spring"]
    own = spring.arm.effect("joint_spring", effect["joint"])
    assert own is not None
    assert {k: p["written"] for k, p in effect["parameters"].items()} == pytest.approx(own.parameters)
    stiffness = effect["parameters"]["stiffness"]
    apart = {**stiffness, "written": stiffness["value"] + 1.5 * stiffness["std"]}
    near = {**stiffness, "written": stiffness["value"] + 0.5 * stiffness["std"]}
    for parameter, found in ((apart, 1), (near, 0)):
        effects = [{**effect, "parameters": {**effect["parameters"], "stiffness": parameter}}]
        held = [c for c in claims(spring.answer | {"effects": effects}) if c.name == "held"]
        assert len(held) == found
        assert all(f"stiffness {parameter['written']:.3g} N m/rad" in c.sentence for c in held)


def test_the_ripples_of_gears_are_those_of_the_refit(spring: Written) -> None:
    answer = spring.answer | {"calibration": [*MOVES, *RIPPLES]}
    (claim,) = [c for c in claims(answer) if c.name == "ripple"]
    assert [m["joint"] for m in claim.numbers["parameters"]] == ["wrist_1_joint", "elbow_joint"]
    assert "0.2 N m at wrist_1_joint (201 cycles a turn) and 0.3 N m at elbow_joint (128 cycles a turn)" in claim.sentence
    assert not [c for c in claims(spring.answer | {"calibration": MOVES}) if c.name == "ripple"]
    (claim,) = [c for c in claims(spring.answer | {"calibration": [*RIPPLES, *RIPPLES]}) if c.name == "ripple"]
    assert claim.sentence.endswith(" and at 1 more joint")


RIPPLES = [
    {
        "name": f"gear ripple of {k} cycles a turn",
        "joint": j,
        "from": 0.0,
        "to": a,
        "unit": "N*m",
        "prior_std": a,
        "gap_share": s,
    }
    for j, k, a, s in (("elbow_joint", 128, 0.3, 0.1), ("wrist_1_joint", 201, 0.2, 0.4))
]
MOVES = [
    {"name": "mass", "joint": "elbow_joint", "from": 12.0, "to": 12.0 + 0.1 * d, "unit": "kg", "prior_std": 0.1}
    for d in (9.0, -2.0)
]
LAW = {"joint": "elbow_joint", "formula": "3.1 z(0.003)", "rms_without": 2.0, "rms_with": 1.5}


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"verdict": "effects_found"}, "missing"),
        ({"verdict": "effects_found", "baseline": ["a", "b", "c"]}, "changed"),
        ({"verdict": "no_missing_effect", "effects": []}, "complete"),
        ({"verdict": "no_missing_effect", "effects": [], "baseline": ["a", "b", "c"]}, "unchanged"),
        ({"verdict": "unexplained"}, "unexplained"),
        ({"verdict": "bad_data", "effects": []}, "bad_data"),
    ],
)
def test_one_verdict_for_every_answer(change: dict[str, Any], name: str) -> None:
    answer = examples.diagnosis()[0] | change
    assert verdict(answer).name == name
    assert sentence(answer) == verdict(answer).sentence
    # a change since healthy recordings is not an error of the arm's model, so nothing is removed
    gained = any(c.name == "removed" for c in claims(answer))
    assert gained == (bool(answer["effects"]) and "baseline" not in answer)


def test_friction_that_drives_a_joint_is_claimed_and_remarked() -> None:
    driving = [
        {"joint": "elbow_joint", "torque": -2.0, "speed": 0.4},
        {"joint": "wrist_3_joint", "torque": -18.0, "speed": 0.5},
    ]
    answer = examples.diagnosis()[0] | {"driving": driving}
    (claim,) = [c for c in claims(answer) if c.name == "driving"]
    assert claim.sentence.startswith("friction drives elbow_joint and wrist_3_joint (-18 N m at 0.5 rad/s at wrist_3_joint)")
    assert any(remark.startswith("Friction drives elbow_joint") for remark in remarks(answer))
    assert "driving" not in {c.name for c in claims(answer | {"driving": []})}


def test_what_else_is_claimed() -> None:
    answer = examples.diagnosis()[0] | {"laws": [LAW], "refused": ["backlash at elbow_joint was fitted"], "calibration": MOVES}
    answer["false_names"] = {"simulated": 999, "chance": 0.08}
    answer["possible"] = [{"effect": "payload", "joint": None, "gain": 20.0, "chance": 0.08, "experiment": "lift nothing."}]
    answer["effects"][0]["indistinguishable_from"] = [{"effect": "payload", "joint": None}]
    made = {c.name: c for c in claims(answer)}
    assert set(made) == {"missing", "removed", "motion", "alike", "law", "possible", "refused", "refit"}
    assert "20 mm RMS with the nominal arm" in made["motion"].sentence
    assert "25%" in made["law"].sentence
    assert [m["to"] - m["from"] > FAR * m["prior_std"] for m in made["refit"].numbers["parameters"]] == [True]
    assert made["alike"].sentence.endswith("cannot be distinguished from payload")
    assert len(remarks(answer)) == 6
    assert made["possible"].sentence == (
        "Possibly payload, which does not pass every test for a name. Of 999 simulated recordings with noise alone, at most 8% show any of "
        "the effects tried as strongly; they leave out errors in the form of the model. To decide: lift nothing"
    )
    assert set(made) <= set(SENTENCES)
