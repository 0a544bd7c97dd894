"""Rows of the sliced topics: they count missed faults, false stops and wrong names."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import arms, clean_mock, demo, faults, first_day, soak, ur_load
from benchmarks.faults import TROUBLES
from benchmarks.published_arms import FACTS, GIVEN
from benchmarks.reaction import Run
from drivers.ur_rtde.condition import program, safety, scaling, slider
from sim.arm import load_arm

STOP = Run(reaction=1, angle=0.1, share=0.9, alone=1.02, beyond=0.002, beside=0.3, time=0.2)


def test_a_missed_fault_and_the_worst_share_are_in_the_row() -> None:
    trouble = next(t for t in TROUBLES if t.stops and t.twin is None)
    worse = Run(reaction=2, angle=0.2, share=1.3, alone=1.4, beyond=0.02, beside=1.1, time=0.4)
    (row,) = faults.rows(trouble, [STOP, worse, Run(missed="run 2: no stop from sample 400 on")], 200)
    assert row["value"] == "2/2 readings; 8.59/11.46 deg; 1.30; 1.10; 400 ms"
    assert "3 of 200 runs, 2 stops, 1 missed" in row["note"]
    assert "no stop from sample 400" in row["note"]


def test_a_stop_that_should_not_be_is_counted() -> None:
    harmless = next(t for t in TROUBLES if not t.stops)
    (row,) = faults.rows(harmless, [STOP, Run()], 200)
    assert (row["value"], row["bar"]) == (1, "0")


def test_a_fault_that_nobody_saw_is_no_stop() -> None:
    (row,) = faults.rows(TROUBLES[0], [Run(missed="x")] * 3, 200)
    assert (row["value"], row["bar"]) == (0, "3")


def test_false_stops_and_missed_faults_of_an_arm() -> None:
    found = {
        "ur5e section 0": {"seconds": 60.0, "stopped": None},
        "ur5e section 1": {"seconds": 12.0, "stopped": "stopped in soak"},
        "ur5e fault 0 cable out": {"reaction": 0},
        "ur5e fault 1 stale readings": {"missed": "run 1: no stop"},
        "ur10e section 0": {"seconds": 60.0, "stopped": "another arm's"},
    }
    stops, missed = soak.rows("ur5e", found, 30.0)
    assert (stops["value"], stops["note"]) == (1, "1.2 of 30 minutes; stopped in soak")
    assert (missed["value"], "stale readings: run 1" in missed["note"]) == (1, True)


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("protective_stop", safety(1 << 2)[1]), ("emergency_stop", safety(1 << 6)[1]), ("reduced_mode", safety(1 << 1)[1]),
        ("slider_moved", slider(0.5)[1]), ("slider_moved", scaling(0.5)[1]), ("program_stopped", program(1)[1]), ("second_client", program(1)[1]),
    ],
)  # fmt: skip
def test_a_name_is_that_of_its_fault_and_of_no_other(fault: str, sentence: str) -> None:
    assert re.search(ur_load.NAMES[fault], sentence)
    same = {"program_stopped", "second_client"}  # identical on the wire
    others = [name for name in ur_load.NAMES if name != fault and not {name, fault} <= same]
    assert not [name for name in others if re.search(ur_load.NAMES[name], sentence)]


def test_a_name_that_nobody_hid_is_counted() -> None:
    seeds = {
        0: {"hidden": ["payload", None], "names": [["payload", None]], "right": True, "verdict": "effects_found"},
        1: {
            "hidden": ["payload", None],
            "names": [["payload", None], ["time_delay", None]],
            "right": False,
            "verdict": "effects_found",
        },
        2: {"hidden": ["torque_gain", "elbow_joint"], "names": [], "right": False, "verdict": "no_missing_effect"},
        3: {
            "hidden": ["torque_gain", "elbow_joint"],
            "names": [["torque_gain", "wrist_1_joint"]],
            "right": False,
            "verdict": "x",
        },
    }
    for seed, f in seeds.items():  # seed 2: the effect does not move the arm
        f["tracking"] = {"nominal": 0.1 if seed == 2 else 1.0, "calibrated": [0.2, 0.4, 0.1, 0.9][seed], "true": 0.1}
    rows = {row["what"]: row for row in demo.rows(seeds, 200)}
    assert rows["demo: what was hidden is the first name"]["value"] == 50.0
    assert rows["demo: what was hidden is identified, and nothing else"]["value"] == 25.0
    assert "seed 2: torque_gain, found no_missing_effect" in rows["demo: what was hidden is the first name"]["note"]
    assert rows["demo: payload hidden"]["value"] == "1 of 2 right"
    over = "demo: tracking error with the calibrated model over that with the"
    median = rows[f"{over} nominal one, median"]
    assert (median["value"], median["bar"], median["note"]) == (0.4, "<= 0.3", "3 seeds")
    assert rows[f"{over} nominal one, largest"]["value"] == 0.9
    assert rows[f"{over} nominal one, largest"]["note"] == "seed 3: torque_gain"
    assert rows[f"{over} true one, median"]["value"] == 3.0


def test_a_clean_mock_with_a_name_or_a_doubt_is_counted() -> None:
    sessions = [
        {"arm": "ur3e", "verdict": "no_missing_effect", "names": [], "over_noise": 1.2, "ratio": 0.99},
        {"arm": "ur5e", "verdict": "effects_found", "names": ["payload"], "over_noise": None, "ratio": 1.2},
        {"arm": "ur3e", "verdict": "no_missing_effect", "names": [], "over_noise": 1.6},
    ]
    rows = {row["what"]: row["value"] for row in clean_mock.rows(sessions, 100, 15)}
    assert rows["nothing hidden: effects identified"] == 1
    assert rows["nothing hidden: sessions not answered `no missing effect`"] == 1
    assert rows["nothing hidden: sessions whose answer says that the model does not agree"] == 1
    assert rows["held-out residual RMS, identified over nominal, worst arm"] == 1.2


def test_a_program_that_was_ended_and_an_arm_that_nobody_named_show() -> None:
    good = {"ended": [], "codes": {"check": [1]}, "faults": []}
    bad = {"ended": ["record: program_played became 1, ['a.urp']"], "codes": {}, "faults": ["watch: not within 60 s"]}
    found = {
        "programs 0": good, "programs 1": bad,
        "wrong ur5e": {"sentence": "this looks like a ur5e or ur7e: set arm"}, "wrong ur30": {"sentence": "this looks like a ur20: set arm"},
        "model ur5e 5.4.0": {"sentence": "update PolyScope: the oldest"}, "model ur5e 5.25.0": {"sentence": "works"},
        "model ur3 3.15.4": {"sentence": "fault: ended with -11: "},
    }  # fmt: skip
    programs, wrong, models = first_day.rows(found, 100)
    assert (programs["value"], programs["bar"]) == (1, "0")
    assert "20 of 100 tries" in programs["note"]
    assert "1 ended otherwise: watch: not within 60 s" in programs["note"]
    assert (wrong["value"], wrong["bar"]) == (1, "12")
    assert "not: ur30: this looks like a ur20" in wrong["note"]
    assert (models["value"], models["bar"]) == (2, "322")
    assert "neither: ('ur3 3.15.4', 'fault: ended with -11: ')" in models["note"]


def test_a_row_names_what_was_given_and_not_the_sentence_that_asked() -> None:
    row = dict.fromkeys(arms.STEPS, 2.0) | {
        "arm": "pr2_right",
        "joints": 7,
        "seconds": 1.0,
        "invented": [],
        "named": [],
        "unexplained": [],
    }
    row |= {
        "ended": "",
        "code": "new",
        "commit": "abc",
        "given": ["q_min, q_max", "if a spring or a counterbalance carries them"],
    }
    assert (
        arms.rows({"pr2_right": row}, "new")[-1]["value"]
        == "through after giving q_min, q_max and the counterbalance of its shoulder"
    )
    asked = {sentence for facts in FACTS.values() for sentence in facts if not sentence.startswith("missing: ")}
    assert set(GIVEN) == asked


def test_an_arm_that_failed_one_that_was_helped_and_a_wrong_name_are_counted() -> None:
    whole = dict.fromkeys(arms.STEPS, 2.0) | {
        "joints": 6,
        "seconds": 14.0,
        "ended": "",
        "given": [],
        "invented": [],
        "named": [],
        "unexplained": [],
        "code": "new",
        "commit": "abc",
    }
    found = {
        "panda": whole | {"arm": "panda", "code": "old", "unexplained": ["panda_joint5"]},
        "z1": whole | {"arm": "z1", "given": ["q_min, q_max"], "named": ["joint_spring at j1"]},
        "ur3": whole | {"arm": "ur3", "ended": "plan: no room", "invented": ["tau_max of j1: 5, its file has nan"]},
    }
    through, made_up, wrong, odd, panda, z1, ur3 = arms.rows(found, "new")
    assert (through["value"], made_up["value"], wrong["value"]) == (2, 1, 1)
    assert "1 with nothing but their file" in through["note"]
    assert "z1: joint_spring at j1" in wrong["note"]
    assert (odd["value"], odd["note"]) == (1, "panda: panda_joint5")
    assert (panda["value"], z1["value"], ur3["value"]) == ("through", "through after giving q_min, q_max", "failed at plan")
    assert "no room" in ur3["note"]
    assert "1 of them on an older commit" in through["note"]
    assert panda["note"].startswith("commit abc; ")
    assert "commit" not in z1["note"] + ur3["note"]


def test_failed_arms_are_tried_again_on_other_code_before_those_that_came_through(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(arms, "FOLDER", tmp_path)
    tried, code = [], ["one"]
    whole = dict.fromkeys(arms.STEPS, 2.0) | {
        "joints": 6,
        "seconds": 14.0,
        "given": [],
        "invented": [],
        "named": [],
        "unexplained": [],
    }

    def line(name: str, home: Path) -> dict[str, object]:
        tried.append(name)
        return whole | {"arm": name, "ended": "plan: no room" if name == "so100" else ""}

    monkeypatch.setattr(arms, "line", line)
    monkeypatch.setattr(arms, "digest", lambda path: code[0])
    arms.run(names=["panda", "so100"])
    arms.run(names=["panda", "so100"])
    assert tried == ["panda", "so100"]
    code[0] = "two"
    arms.run(names=["panda", "so100", "z1"])
    assert tried[2:] == ["z1", "so100", "panda"]
    assert arms.run(names=["panda", "so100", "z1"])[0]["note"].startswith("3 of 29 tried; ")


def test_the_sentence_of_a_command_is_its_error_or_its_answer() -> None:
    def ended(out: str, err: str) -> str:
        return arms.sentence_of(subprocess.CompletedProcess([], 1, out, err))

    assert ended("", "record 5 of 9 s\ncalib: stopped:\n  joint3: torque\n") == "stopped: joint3: torque"
    assert ended("joint 1\nPoor: at joint1.\nnext: calib diagnose\n", "identify ...\n").startswith("Poor: at joint1")
    assert "limits.dq_max = 100" in ended("speed  ok  0.1\nsettings  NO  limits.dq_max = 100\n", "calib: see the remedies\n")
    assert ended("", "") == "no sentence"


def test_a_fact_is_given_only_where_a_sentence_asks_for_it(tmp_path: Path) -> None:
    row = {"ended": "new: missing: q_min, q_max"}
    assert arms.answer("kinova_j2s6s200", row, tmp_path)[0] == "q_min, q_max"
    assert arms.answer("panda", row, tmp_path) == ("", [])
    assert arms.answer("panda", {"ended": "record: stopped"}, tmp_path) == ("", [])


def test_a_limit_that_neither_file_nor_option_states_is_invented(tmp_path: Path) -> None:
    arm = load_arm("ur10e")
    joints = (
        f'<joint name="{name}" type="revolute"><limit lower="{low!r}" upper="{high!r}" velocity="{fast!r}" effort="{strong!r}"/></joint>'
        for name, low, high, fast, strong in zip(
            arm.joint_names, arm.q_min.tolist(), arm.q_max.tolist(), arm.dq_max.tolist(), arm.tau_max.tolist(), strict=True
        )
    )
    file = tmp_path / "arm.urdf"
    file.write_text(f"<robot name='x'>{''.join(joints)}</robot>")
    options = ["--limit", "ddq_max=5", "--limit", "jerk_max=100"]
    assert arms.invented(arm, file, options) == []
    assert len(arms.invented(arm, file, options[:2])) == arm.n
    more = replace(arm, tau_max=np.append(arm.tau_max[:5], arm.tau_max[5] + 1.0))
    assert [x.split(":")[0] for x in arms.invented(more, file, options)] == ["tau_max of wrist_3_joint"]
