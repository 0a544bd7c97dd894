"""A live watch refuses readings that cannot be the arm's once it has enough motion, and keeps them out of the trend."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.wrong_data import base
from calib.main import main
from calib.past_runs import read_run
from calib.watch import live_gate, source
from calib.watch.live_gate import LiveGate
from calib.watch.session import watch
from calib.watch.source import Source, states_of
from logs import Recorder, read_log
from logs.log import Log, State
from sim.errors import BadLog, DeviceError
from sim.joint_state import JointState

WRONG = np.array([1, 1, -1, 1, 1, 1])
SEEN = "the torque \\(or current\\) of elbow_joint has the wrong sign"


@pytest.fixture(scope="module")
def log() -> Log:
    return base("servo6 2")[1]


def live(states: Iterator[JointState]) -> Source:
    return Source("a-cell", base("servo6 2")[0], 100.0, states, lambda: None, live=True, gated=True)


def test_a_reversed_torque_ends_the_watch_with_its_cause(tmp_path: Path, log: Log) -> None:
    wrong = replace(log, tau=log.tau * WRONG)
    with pytest.raises(BadLog, match=f"a-cell: .*{SEEN}"):
        watch(live(states_of(wrong)), tmp_path, database=tmp_path / "trend.sqlite")
    events = read_log(tmp_path / "watch.mcap").events
    assert [e.name for e in events][-1] == "gate"
    assert "wrong sign" in events[-1].message
    assert not (tmp_path / "trend.sqlite").exists()
    kept = json.loads((tmp_path / "watch.json").read_text())
    assert kept["refusal"] == kept["outcome"] == events[-1].message
    assert kept["payload"] is None
    assert not kept["trend"]


def failing(log: Log, readings: int) -> Iterator[JointState]:
    yield from itertools.islice(states_of(log), readings)
    raise DeviceError("a-cell: no reading for 0.5 s; look at the cable")


def test_a_device_that_fails_leaves_what_was_seen(tmp_path: Path, log: Log) -> None:
    found = watch(live(failing(log, len(log))), tmp_path, database=tmp_path / "trend.sqlite")
    assert str(found.fault).startswith("a-cell: no reading")
    kept = json.loads((tmp_path / "watch.json").read_text())
    assert kept["fault"] == str(found.fault)
    assert kept["samples"] == len(log)
    written = read_log(tmp_path / "watch.mcap", accept_partial=True)
    assert written.state is State.ABORTED
    assert written.events[-1].name == "device"


def test_a_wrong_torque_is_refused_where_the_device_fails_as_well(tmp_path: Path, log: Log) -> None:
    with pytest.raises(BadLog, match=SEEN):
        watch(live(failing(replace(log, tau=log.tau * WRONG), 600)), tmp_path, database=tmp_path / "trend.sqlite")
    assert json.loads((tmp_path / "watch.json").read_text())["fault"].startswith("a-cell: no reading")


def test_a_failed_watch_says_in_its_run_what_was_seen(
    desk: Path, monkeypatch: pytest.MonkeyPatch, log: Log, capsys: pytest.CaptureFixture[str]
) -> None:
    @contextmanager
    def opened(*_: object) -> Iterator[Source]:
        yield live(failing(log, 600))

    monkeypatch.setattr(source, "open_source", opened)
    assert main(["watch", "a-cell", "--json"]) == 4
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["fault"].startswith("a-cell: no reading")
    run = read_run("watch")
    assert run.exit_code == 4
    assert run.sentence.startswith("a-cell: no reading for 0.5 s; look at the cable; until then: ")
    assert (run.folder / "watch.json").is_file()


def test_a_recording_that_fails_is_a_fault_and_not_the_end_of_the_answer(
    tmp_path: Path, log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise DeviceError("watch.mcap: the disk is full")

    monkeypatch.setattr(Recorder, "event", full)
    found = watch(live(failing(log, 300)), tmp_path)
    assert "no reading" in str(found.fault)
    monkeypatch.setattr(Recorder, "write", full)
    (tmp_path / "second").mkdir()
    found = watch(live(states_of(log)), tmp_path / "second")
    assert "the disk is full" in str(found.fault)
    assert (tmp_path / "second" / "watch.json").is_file()


def test_a_short_watch_is_examined_at_its_end(tmp_path: Path, log: Log) -> None:
    few = [state for state, _ in zip(states_of(replace(log, tau=log.tau * WRONG)), range(600), strict=False)]
    with pytest.raises(BadLog, match=SEEN):
        watch(live(iter(few)), tmp_path)


def test_the_arms_own_readings_pass_and_nothing_is_examined_again(
    tmp_path: Path, log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    examined = live_gate.examined
    monkeypatch.setattr(live_gate, "examined", lambda arm, logs: (calls.append(len(logs[0])), examined(arm, logs))[1])
    found = watch(live(states_of(log)), tmp_path)
    assert found.seconds == pytest.approx(log.t[-1] - log.t[0])
    assert len(calls) == 1
    # the watch continues during the check, so not all of the log is in it
    assert calls[0] < len(log)


def test_an_arm_that_stands_is_examined_only_at_the_end(log: Log) -> None:
    gate = LiveGate(base("servo6 2")[0], "a-cell", 100.0)
    standing = JointState(0.0, 0.0, log.q[0], 0 * log.q[0], log.tau[0], log.current[0], log.temperature[0])
    assert all(gate.add(replace(standing, t=0.01 * k, t_device=0.01 * k)) is None for k in range(3000))
    assert gate._pending is None
    assert gate.end() is None


@pytest.mark.parametrize("reversed_", [False, True])
def test_lost_samples_are_events_and_hide_no_wrong_torque(tmp_path: Path, log: Log, reversed_: bool) -> None:
    """The last 40 of every 100 ms are missing."""
    readings = states_of(replace(log, tau=log.tau * WRONG) if reversed_ else log)
    left = (s for k, s in enumerate(readings) if k % 10 < 6)
    if reversed_:
        with pytest.raises(BadLog, match=SEEN):
            watch(live(left), tmp_path)
        return
    found = watch(live(left), tmp_path)
    assert {e.kind.value for e in found.events} == {"gap"}
    assert json.loads((tmp_path / "watch.json").read_text())["refusal"] is None


def test_readings_without_a_time_or_none_at_all_are_no_reason_to_refuse(log: Log) -> None:
    gate = LiveGate(base("servo6 2")[0], "a-cell", 100.0)
    assert gate.add(replace(next(states_of(log)), t_device=float("nan"))) is None
    assert gate.end() is None


def test_a_live_watch_can_be_left_unchecked_and_not_converted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--seconds", "0.2", "--database", str(tmp_path / "t")]
    assert main(["watch", "mock-ur10e", "--assume", "as-recorded", "--out", str(tmp_path / "a"), *out]) == 0
    assert main(["watch", "mock-ur10e", "--assume", "q=deg", "--out", str(tmp_path / "b"), *out]) == 2
    assert "--assume q=deg: is for recordings" in capsys.readouterr().err
