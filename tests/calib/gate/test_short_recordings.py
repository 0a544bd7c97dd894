"""Short recordings: the motion that a diagnosis needs, and a few seconds that are not reported as wrong readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.wrong_data import base, family
from calib.gate import gate, readings
from calib.gate.commands import examined
from logs.log import Log


def test_seconds_of_motion_are_counted() -> None:
    of, log = base("servo6 2")
    few = log.t < log.t[0] + 4.0
    short = replace(log, **{name: getattr(log, name)[few] for name in ("t", "t_host", "q", "dq", "tau", "current", "temperature",
                                                                      "q_cmd", "dq_cmd", "tau_cmd")})  # fmt: skip
    assert gate(of, [short]).refusal is None
    refusal = gate(of, [short], least_motion=5.0).refusal or ""
    assert "record a longer one" in refusal
    assert gate(of, [log], least_motion=20.0).refusal is None
    gappy = np.arange(len(log)) % 7 != 3  # gaps of one sample cost only that sample
    assert gate(of, [replace(log, **{name: getattr(log, name)[gappy] for name in ("t", "t_host", "q", "dq", "tau", "current",
                     "temperature", "q_cmd", "dq_cmd", "tau_cmd")})], least_motion=20.0).refusal is None  # fmt: skip


def part(log: Log, since: float, until: float) -> Log:
    keep = (log.t >= log.t[0] + since) & (log.t < log.t[0] + until)
    arrays = ("t", "t_host", "q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
    return replace(log, **{name: getattr(log, name)[keep] for name in arrays})


def test_motion_of_several_recordings_counts_together() -> None:
    of, log = base("servo6 2")

    parts = [part(log, 3.0, 6.5), part(log, 6.5, 10.0)]
    alone, refusal = examined(of, parts[:1], parts[:1])
    assert "5 s are needed" in (refusal or "")
    assert [check.ok for check in alone if check.check == "motion"] == [False]
    together, refusal = examined(of, parts, parts)
    assert refusal is None
    assert any(check.ok and check.check == "motion" and "in 2 recordings" in check.detail for check in together)
    shorter = [part(log, 3.0, 5.2), part(log, 6.5, 8.7)]
    _, refusal = examined(of, shorter, shorter)
    assert "4.3 s with a joint in motion in 2 recordings, 5 s are needed" in (refusal or "")


@pytest.mark.parametrize(("name", "since", "until"), [("ur5e 1", 0.0, 4.0), ("servo6 2", 1.5, 3.0), ("ur10e 3", 4.5, 6.0)])
def test_a_short_part_of_a_good_recording_is_not_refused(name: str, since: float, until: float) -> None:
    """Joints that move in one direction only, whose dry friction is an offset, and joints that hardly move."""
    of, log = base(name)
    assert gate(of, [part(log, since, until)], family=family).refusal is None


def test_what_was_not_checked_is_not_reported_as_checked() -> None:
    of, log = base("servo6 2")
    short, whole = (
        [c.detail for c in gate(of, [x], family=family).checks if c.check == "torque"] for x in (part(log, 1.5, 3.0), log)
    )
    assert short == ["no joint moves for 3 s: signs and columns of torques or currents cannot be checked"]
    assert whole == ["no other sign, column or clock makes the arm's model fit better"]


def test_motion_that_just_falls_short_does_not_read_like_enough() -> None:
    t = np.arange(0.0, 5.97, 0.01)
    q = np.where(t < 4.99, t, 4.99)[:, None]
    _, log = base("servo6 2")
    arrays = {name: np.zeros((len(t), 1)) for name in ("dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")}
    check = readings.motion([replace(log, joint_names=("a",), t=t, t_host=t, q=q, **arrays)], 5.0)
    assert not check.ok
    assert "4.9 s with a joint in motion" in check.detail
