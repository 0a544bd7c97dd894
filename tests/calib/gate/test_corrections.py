"""The words that --assume accepts, and how each of them changes a recording."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.wrong_data import arm, base
from calib.gate import Correction, applied, gate, parsed
from calib.gate.commands import read_as
from logs.log import Log
from sim.errors import ConfigError

WORDS = (
    "t=ms", "q=deg", "dq=rpm", "current=mA", "current=int16", "tau=int32", "tau=mNm", "tau=current", "shift=0.25", "sign:tau:elbow_joint", "swap:all:elbow_joint,wrist_1_joint",
    "sign:motion:wrist_3_joint", "scale:tau:elbow_joint=101", "scale:tau=0.1", "scale:q:elbow_joint=-3",
)  # fmt: skip


@pytest.mark.parametrize("word", WORDS)
def test_words_of_assume_are_what_corrections_are_called(word: str) -> None:
    of, log = base("servo6 sample")
    c = parsed(word, of.joint_names)
    assert c.word(of.joint_names) == word
    assert c.sentence(of.joint_names)
    read = applied(log, c)
    assert json.loads(read.metadata["assumed"]) == [word]
    assert isinstance(read, Log)


@pytest.mark.parametrize(
    "word",
    ["", "q", "q=grad", "deg", "t=h", "sign:tau", "sign:tau:elbow", "sign:tau:elbow_joint=2", "swap:tau:elbow_joint",
     "swap:tau:elbow_joint,elbow_joint", "scale:tau:elbow_joint", "scale:tau=0", "scale:all=2", "shift=x", "shift=nan", "turn:q:elbow_joint",
     "sign:torque:elbow_joint", "scale:tau=1e99"],
)  # fmt: skip
def test_words_that_are_none(word: str) -> None:
    with pytest.raises(ConfigError, match="--assume"):
        parsed(word, arm("servo6").joint_names)


def test_a_signed_word_that_was_kept_unsigned_is_named() -> None:
    of, log = base("servo6 sample")
    raw = np.rint(100 * log.tau)
    kept = replace(log, tau=raw % 65536)
    found = gate(of, [kept])
    assert found.refusal is not None
    assert "--assume tau=int16" in found.refusal
    np.testing.assert_array_equal(applied(kept, parsed("tau=int16", of.joint_names)).tau, raw)
    assert "words" not in [check.check for check in gate(of, [read_as(kept, ["tau=int16"])]).checks if not check.ok]


def test_as_recorded_lifts_the_refusal_and_says_so() -> None:
    of, log = base("servo6 2")
    wrong = replace(log, tau=-log.tau)
    assert gate(of, [wrong]).refusal
    read = read_as(wrong, ["as-recorded"])
    found = gate(of, [read])
    assert found.refusal is None
    assert json.loads(read.metadata["assumed"]) == ["as-recorded"]
    assert any(not check.ok for check in found.checks)


def test_two_corrections_are_applied_in_the_order_they_are_stated() -> None:
    _, log = base("servo6 sample")
    twice = applied(applied(log, Correction("sign", "tau", (0,))), Correction("sign", "tau", (0,)))
    np.testing.assert_array_equal(twice.tau, log.tau)
    assert len(json.loads(twice.metadata["assumed"])) == 2


@pytest.mark.parametrize(
    ("name", "by"),
    [
        *((name, by) for name in ("ur10e sample", "servo6 2") for by in (-1.37, -0.63, -0.2, 0.31, 0.8)),
        ("ur5e 1", -4.4),
        ("ur5e 1", 6.3),
    ],
)
def test_another_clock_is_stated_as_exactly_as_it_can_be_undone(name: str, by: float) -> None:
    """One word of --assume is enough, and it is the shift that was made."""
    of, log = base(name)
    late = {
        key: np.stack([np.interp(log.t - by, log.t, x) for x in getattr(log, key).T], axis=1)
        for key in ("tau", "current")
        if np.isfinite(getattr(log, key)).any()
    }
    found = gate(of, [replace(log, **late)])
    (correction,) = found.causes[0].corrections
    assert correction.kind == "shift"
    assert correction.factor == pytest.approx(by, abs=0.06)
    assert ("lags" if by > 0 else "leads") in found.causes[0].sentence
    assert gate(of, [read_as(replace(log, **late), [correction.word(of.joint_names)])]).refusal is None
