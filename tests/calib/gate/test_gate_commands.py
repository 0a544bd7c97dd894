"""Commands refuse a wrong recording with its cause first, also among good ones, and --assume reads it another way."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.known_truth import fourier_motion, recorded
from benchmarks.wrong_commands import through
from benchmarks.wrong_data import Case, base, changes, scaled, within
from calib.gate import gate
from calib.gate.commands import passed, read_as, require
from calib.identification.identify import identify
from calib.main import main
from calib.validation.validate import validate
from logs import read_log
from logs.convert import write_log
from logs.log import Log
from sim.arm import Arm
from sim.errors import BadLog


def test_import_refuses_and_reads_another_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    of, log = base("ur10e sample")
    names = [f"{stem}_{j}" for stem in ("actual_q", "actual_qd", "actual_current") for j in range(6)]
    current = log.current * np.array([1, -1, 1, 1, 1, 1])
    rows = np.column_stack([log.t, log.q, log.dq, current])
    np.savetxt("wrong.csv", rows, "%.6f", ",", header=",".join(["timestamp", *names]), comments="")
    assert main(["import", "wrong.csv", "--arm", "ur10e", "--out", "first"]) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert "the torque (or current) of shoulder_lift_joint has the wrong sign" in printed
    assert not list(Path("first").glob("*.mcap"))
    word = "sign:tau:shoulder_lift_joint"
    assert word in printed
    assert main(["import", "wrong.csv", "--arm", "ur10e", "--assume", word, "--out", "second"]) == 0
    assert word in capsys.readouterr().out
    read = read_log("second/wrong.mcap", of.joint_names)
    assert json.loads(read.metadata["assumed"]) == [word]
    np.testing.assert_allclose(read.current, log.current, atol=1e-6)
    assert main(["import", "wrong.csv", "--assume", word]) == 2
    assert "name it with --arm" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["identify", "validate", "diagnose", "watch"])
@pytest.mark.parametrize(
    "what", ["degrees", "speeds in deg/s", "load reversed, elbow_joint", "joints exchanged, elbow_joint,wrist_1_joint"]
)
def test_every_command_refuses_with_the_cause_first(
    command: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    of, log = base("servo6 2")
    wrong, right = changes(of)[what](log, of, np.random.default_rng(5))
    code, cause = through(command, Case(what, of, (wrong,), (what,), right), tmp_path)
    assert code == 2
    assert any(word in cause for word in right), cause
    assert command == "diagnose" or not list(tmp_path.glob("out/arm"))


def test_a_good_log_hides_no_bad_one(tmp_path: Path) -> None:
    of, log = base("servo6 2")
    other = recorded_again(of)
    wrong = replace(other, tau=other.tau * np.array([1, 1, -1, 1, 1, 1]))
    for ask in (lambda: identify(of, [log], [wrong]), lambda: identify(of, [wrong, log]), lambda: validate(of, [log, wrong])):
        with pytest.raises(BadLog, match=r"Most likely cause: the torque \(or current\) of elbow_joint has the wrong sign"):
            ask()
    with pytest.raises(BadLog, match="the same recording"):
        identify(of, [log], [replace(log, q=np.round(log.q, 6))])


def recorded_again(of: Arm) -> Log:
    return recorded(of, within(of, fourier_motion(of, 77, 12.0, 100.0)), 5)


def test_a_recording_given_twice_is_not_offered_as_recorded() -> None:
    of, log = base("ur10e sample")
    with pytest.raises(BadLog, match="hold the same samples") as error:
        require(of, [log, log])
    assert "as-recorded" not in str(error.value)


@pytest.mark.parametrize(("metadata", "remedy"), [({}, "record it again"), ({"column_map": ""}, "--rate HZ")])
def test_stamps_coarser_than_the_samples_are_read_by_nobody_as_recorded(metadata: dict[str, str], remedy: str) -> None:
    of, log = base("ur10e sample")
    rounded = replace(log, t=np.floor(log.t), metadata=metadata)
    for ask in (
        lambda: require(of, [rounded]),
        lambda: require(of, [read_as(rounded, ["as-recorded"])]),
        lambda: passed(of, ["as-recorded"])(rounded),
    ):
        with pytest.raises(BadLog, match="coarser than the samples") as error:
            ask()
        assert remedy in str(error.value)
        assert "as-recorded" not in str(error.value)
        assert ("--rate" in str(error.value)) == bool(metadata)


def test_a_clock_that_was_set_loses_no_samples() -> None:
    of, log = base("ur10e sample")
    k = int(np.argmax(np.abs(log.dq).max(axis=1)))
    later = replace(log, t=log.t + 1.0 * (np.arange(len(log)) > k))
    details = [next(c.detail for c in gate(of, [x]).checks if c.check == "losses") for x in (log, later)]
    assert details[0].split(",")[0] == details[1].split(",")[0]


def test_what_an_import_assumed_is_assumed_by_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    of, log = base("servo6 2")
    write_log(scaled(log, ("tau",), 0.02), tmp_path / "wrong.mcap", "clean", {})
    assert main(["validate", "servo6", "wrong.mcap", "--no-forward"]) == 2
    assert main(["validate", "servo6", "wrong.mcap", "--no-forward", "--assume", "scale:tau=0.02"]) in (0, 1)
    assert main(["import", "wrong.mcap", "--arm", "servo6", "--assume", "as-recorded", "--out", "taken"]) == 0
    assert json.loads(read_log("taken/wrong.mcap", of.joint_names).metadata["assumed"]) == ["as-recorded"]
    assert main(["validate", "servo6", "taken/wrong.mcap", "--no-forward", "--out", "assessed"]) == 2
    assert json.loads(Path("assessed/validation.json").read_text())["verdict"] == "wrong arm"
