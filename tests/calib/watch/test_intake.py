"""Bad readings are reported with their value and never become an event about the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.watch.events import CONCERNS, Kind, WatchEvent
from calib.watch.source import until
from calib.watch.watcher import Watcher
from sim.arm import Arm
from sim.joint_state import JointState
from tests.calib.watch.conftest import AT

Fresh = Callable[[], Watcher]


def spoiled(readings: list[JointState], **changes: Any) -> list[JointState]:
    """The readings from `AT` on, the first of them corrupted."""
    return [replace(readings[AT], **changes), *readings[AT + 1 : AT + 400]]


def watched(watcher: Watcher, readings: list[JointState]) -> list[WatchEvent]:
    return [event for state in readings for event in watcher.add(state)]


def one(value: np.ndarray, j: int, wrong: float) -> np.ndarray:
    out = value.copy()
    out[j] = wrong
    return out


@pytest.mark.parametrize("field", ["q", "dq", "tau"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e279, -1e6])
def test_a_value_that_no_arm_has(at_work: Fresh, calm: list[JointState], field: str, wrong: float) -> None:
    readings = spoiled(calm, **{field: one(getattr(calm[AT], field), 2, wrong)})
    events = watched(at_work(), readings)
    assert [e.kind for e in events] == [Kind.BAD_READING]
    assert "elbow_joint" in events[0].message
    assert events[0].about == "input"


def test_one_wild_torque_between_two_sane_ones(at_work: Fresh, calm: list[JointState]) -> None:
    events = watched(at_work(), spoiled(calm, tau=calm[AT].tau + np.array([0, 20.0, 0, 0, 0, 0])))
    assert [e.kind for e in events] == [Kind.BAD_READING]
    assert "one reading of" in events[0].message


def test_a_jump_of_position(at_work: Fresh, calm: list[JointState]) -> None:
    events = watched(at_work(), spoiled(calm, q=one(calm[AT].q, 0, calm[AT].q[0] + 0.5)))
    assert {e.kind for e in events} == {Kind.BAD_READING}


def test_a_gap(at_work: Fresh, calm: list[JointState]) -> None:
    events = watched(at_work(), [calm[AT], *calm[AT + 61 :]])
    assert [e.kind for e in events] == [Kind.GAP]
    assert "no reading for 305 ms" in events[0].message


@pytest.mark.parametrize("t_device", [np.nan, -5.0, 14.0])
def test_a_clock_that_jumps(at_work: Fresh, calm: list[JointState], t_device: float) -> None:
    events = watched(at_work(), spoiled(calm, t_device=t_device))
    assert {e.about for e in events} == {"input"}


def test_torques_that_have_frozen(at_work: Fresh, calm: list[JointState]) -> None:
    frozen = [replace(s, tau=calm[AT].tau) for s in calm[AT : AT + 300]]
    events = watched(at_work(), [*frozen, *calm[AT + 300 :]])
    assert Kind.FROZEN in {e.kind for e in events}
    assert {e.about for e in events} == {"input"}


def test_another_number_of_joints(at_work: Fresh, calm: list[JointState]) -> None:
    short = [
        JointState(s.t, s.t_device, *(getattr(s, x)[:5] for x in ("q", "dq", "tau", "current", "temperature")))
        for s in calm[:50]
    ]
    events = watched(at_work(), short)
    assert [e.kind for e in events] == [Kind.WRONG_ARM]


def test_many_faults_are_reported_once_in_a_while_and_counted(at_work: Fresh, calm: list[JointState]) -> None:
    watcher = at_work()
    rng = np.random.default_rng(0)
    readings = [replace(s, tau=one(s.tau, 1, np.nan)) if rng.random() < 0.02 else s for s in calm[AT:]]
    events = [event for state in readings for event in watcher.add(state)]
    assert {e.kind for e in events} == {Kind.BAD_READING}
    assert len(events) <= 3
    assert watcher.picture().faults["bad_reading"] > 10


def test_an_arm_whose_limits_nobody_stated_loses_no_reading(servo6: Arm, calm: list[JointState]) -> None:
    silent = servo6.sensors.model_copy(update={"torque_noise": (0.0,) * servo6.n})
    bare = replace(servo6, tau_max=np.full(servo6.n, np.nan), sensors=silent)
    assert not [e for e in watched(Watcher(bare, 200.0), calm) if e.kind is Kind.BAD_READING]


def test_the_first_seconds_begin_with_the_first_reading_that_has_a_time(calm: list[JointState]) -> None:
    readings = [replace(calm[0], t_device=np.nan), *calm[1:]]
    span = calm[-1].t_device - calm[1].t_device
    taken = list(until(iter(readings), span / 2))
    assert len(calm) / 3 < len(taken) < len(calm) * 2 / 3


def test_a_reading_that_comes_twice_counts_once(servo6: Arm, calm: list[JointState]) -> None:
    once, twice = Watcher(servo6, 200.0), Watcher(servo6, 200.0)
    watched(once, calm)
    assert watched(twice, [copy for k, s in enumerate(calm) for copy in ((s, s) if k % 4 == 0 else (s,))]) == []
    assert twice.picture().faults == {"repeated": len(calm) // 4}
    assert twice.picture().payload == once.picture().payload


def test_a_reading_that_is_left_out_is_no_more_than_a_lost_one(servo6: Arm, calm: list[JointState]) -> None:
    """Every block contains a bad reading."""
    watcher = Watcher(servo6, 200.0)
    readings = [replace(s, q=one(s.q, 1, np.nan)) if k % 4 == 0 else s for k, s in enumerate(calm)]
    assert {e.kind for e in watched(watcher, readings)} == {Kind.BAD_READING}
    picture = watcher.picture()
    assert picture.faults["bad_reading"] == len(calm) // 4
    assert picture.settled
    assert abs(picture.payload.value) < 3 * picture.payload.std + 0.01


def test_motion_of_which_nothing_can_be_used_is_a_concern_and_not_rest(servo6: Arm, calm: list[JointState]) -> None:
    """30 ms are missing after every third reading, so no two blocks are contiguous."""
    late = [replace(s, t_device=s.t_device + 0.03 * (k // 3)) for k, s in enumerate(calm)]
    watcher = Watcher(servo6, 200.0)
    events = watched(watcher, late)
    assert [e.kind for e in events if e.kind is not Kind.GAP] == [Kind.UNWATCHABLE]
    assert "hardly any reading could be used (gap: " in next(e.message for e in events if e.kind is Kind.UNWATCHABLE)
    assert Kind.UNWATCHABLE in CONCERNS
    assert watcher.picture().sentence == "no claim: the readings are too broken to watch"


def test_broken_readings_of_a_standing_arm_hide_no_motion(servo6: Arm, calm: list[JointState]) -> None:
    silent = np.full(servo6.n, np.nan)
    standing = [replace(s, q=calm[0].q, dq=0 * silent, tau=silent) for s in calm]
    watcher = Watcher(servo6, 200.0)
    assert Kind.UNWATCHABLE not in {e.kind for e in watched(watcher, standing)}
    assert watcher.picture().sentence == "no claim: no reading could be used"


@pytest.mark.parametrize("stated", [50.0, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (80.0, 400.0)), 800.0])
def test_a_rate_that_is_stated_wrongly_is_named_and_no_wrong_arm(servo6: Arm, calm: list[JointState], stated: float) -> None:
    watcher, right = Watcher(servo6, stated), Watcher(servo6, 200.0)
    watched(right, calm)
    events = watched(watcher, calm)
    (named,) = [e for e in events if e.kind is Kind.WRONG_RATE]
    assert named.message.startswith(f"readings come every 5 ms, but the stated period is {1e3 / stated:.3g} ms")
    assert {e.kind for e in events} <= {Kind.WRONG_RATE, Kind.GAP}
    picture, expected = watcher.picture(), right.picture()
    assert picture.fits
    assert picture.settled
    assert abs(picture.payload.value - expected.payload.value) < expected.payload.std


def test_bursts_and_gaps_are_no_other_rate(servo6: Arm, calm: list[JointState]) -> None:
    bursts = [replace(s, t_device=round(s.t_device / 0.02) * 0.02 + 1e-4 * (k % 4)) for k, s in enumerate(calm[:600])]
    gaps = [s for k, s in enumerate(calm[:900]) if k % 10 < 6]
    for readings in (bursts, gaps):
        assert Kind.WRONG_RATE not in {e.kind for e in watched(Watcher(servo6, 200.0), readings)}
