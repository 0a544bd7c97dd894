"""A stop is reported in one sentence and in numbers, across processes too, with the last samples before it."""

from __future__ import annotations

import json
import pickle

import numpy as np

from safety.trip import LastSamples, MotionStopped, Standstill, Trip
from sim.joint_state import JointState


def reading(t: float) -> JointState:
    return JointState(t, t, *(np.zeros(2) for _ in range(5)))


def test_it_crosses_a_process_boundary_whole() -> None:
    rest = Standstill("along the path", 0.3, (0.1, 0.2), (0.11, 0.2), False)
    stop = MotionStopped(Trip("speed", 2.31, 2.09, "rad/s", "plan a slower motion", "elbow"), 3.4, rest, (reading(3.4),), "x")
    again = pickle.loads(pickle.dumps(stop))
    assert str(again) == str(stop)
    assert (again.trip, again.standstill, len(again.samples), again.exit_code) == (stop.trip, rest, 1, 3)
    assert json.loads(json.dumps(again.record())) == {
        "where": "x", "t": 3.4, "joint": "elbow", "quantity": "speed", "value": 2.31, "limit": 2.09, "unit": "rad/s",
        "stop": "along the path", "stop_time": 0.3, "stop_angle": [0.1, 0.2], "at_rest": False,
    }  # fmt: skip
    assert "elbow: speed 2.31 rad/s, limit 2.09 rad/s; plan a slower motion" in str(stop)
    assert "NOT seen to stand still" in str(stop)


def test_what_was_added_later_crosses_a_process_boundary_too() -> None:
    rest = Standstill("along the path", 0.3, (0.1,), (0.11,), True)
    stop = MotionStopped(Trip("speed", 2.31, 2.09, "rad/s", "slower", "elbow"), 3.4, rest, (reading(3.4),), "x")
    stop.args = (f"{stop}; besides, a drive is still on",)
    stop.add_note("the disk is full")
    again = pickle.loads(pickle.dumps(stop))
    assert str(again).endswith("slower; besides, a drive is still on")
    assert again.__notes__ == ["the disk is full"]
    assert len(again.samples) == 1


def test_a_trip_without_joint_and_unit_is_a_sentence_too() -> None:
    assert str(Trip("device status", "fault", "running", "", "look")) == "device status fault, limit running; look"


def test_only_the_last_samples_are_kept() -> None:
    kept = LastSamples(5)
    for k in range(100):
        kept.add(reading(float(k)))
        assert len(kept.states) <= 10
    assert [s.t for s in kept.latest()] == [95.0, 96.0, 97.0, 98.0, 99.0]
