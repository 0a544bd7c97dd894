"""A malformed diagnosis.json ends a guided session with a sentence that names the file and the field."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from calib.excitation.discriminate import pairs_of
from calib.guided_answer import answer
from sim.arm import load_arm
from sim.errors import ConfigError
from tests.calib.guided_desk import NOTHING, Commands, go, session

ODD: list[tuple[Any, str]] = [
    ([], "it is [], not a table"),
    ({"verdict": "effects_found"}, "effects is missing"),
    (NOTHING | {"effects": "payload"}, "effects is 'payload', not a list"),
    (NOTHING | {"effects": ["payload"]}, "effects[0] is 'payload', not a table"),
    (NOTHING | {"effects": [{"joint": None, "indistinguishable_from": [{"effect": "a"}]}]}, "effects[0].effect is missing"),
    (NOTHING | {"effects": [{"effect": 3}]}, "effects[0].effect is 3, not a name"),
    (NOTHING | {"effects": [{"effect": "payload", "joint": 1}]}, "effects[0].joint is 1, not a name"),
    (
        NOTHING | {"effects": [{"effect": "payload", "indistinguishable_from": 3}]},
        "effects[0].indistinguishable_from is 3, not a list",
    ),
    (
        NOTHING | {"effects": [{"effect": "payload", "indistinguishable_from": [{}]}]},
        "effects[0].indistinguishable_from[0].effect is missing",
    ),
    (NOTHING | {"verdict": "unexplained", "unexplained": ["elbow_joint"]}, "unexplained[0] is 'elbow_joint', not a table"),
    (NOTHING | {"arm_out": 3}, "arm_out is 3, not a word"),
    (NOTHING | {"laws": [3]}, "laws[0] is 3, not a table"),
]


@pytest.mark.parametrize(("content", "fault"), ODD)
def test_an_odd_diagnosis_is_a_sentence_and_no_traceback(
    content: Any, fault: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert go(Commands([content]), monkeypatch, "--yes") == 2
    error = capsys.readouterr().err
    assert f"diagnosis/diagnosis.json: not a diagnosis: {fault}; the session cannot continue with it: restore the file" in error
    assert "--new" in error
    found = session(desk)
    assert not found.closed
    # the session continues once the file is restored
    (found.folder / "diagnosis/diagnosis.json").write_text(json.dumps(NOTHING))
    assert go(Commands([]), monkeypatch, "--yes") == 0


def test_a_sound_answer_is_read_as_it_is(tmp_path: Path) -> None:
    whole = NOTHING | {
        "effects": [{"effect": "payload", "joint": None, "indistinguishable_from": [{"effect": "link_inertia", "joint": "a"}]}],
        "unexplained": [{"joint": "elbow_joint"}],
    }
    (tmp_path / "diagnosis.json").write_text(json.dumps(whole))
    assert answer(tmp_path) == whole


def test_effects_whose_parameters_are_no_table_cannot_be_distinguished(tmp_path: Path) -> None:
    effect = {"effect": "payload", "joint": None, "parameters": [], "indistinguishable_from": []}
    (tmp_path / "diagnosis.json").write_text(json.dumps({"effects": [effect]}))
    with pytest.raises(ConfigError, match="not a diagnosis"):
        pairs_of(tmp_path, load_arm("ur10e"))
