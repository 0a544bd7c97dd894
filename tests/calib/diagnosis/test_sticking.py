"""Joints of the mock stick at every change of direction until their drives have built up torque; effects are found all the same."""

from __future__ import annotations

import pytest

from benchmarks.known_truth import fitting_motion, recorded_on_mock
from calib.diagnosis.diagnose import diagnose
from logs.log import Log
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from sim.trajectory import Trajectory


def on_the_mock(truth: Arm, arm: Arm, seed: int) -> Log:
    """A recording of 8 s at 250 Hz."""
    m = fitting_motion(arm, seed, 8.0)
    return recorded_on_mock(truth, arm, Trajectory(m.t[::2], m.q[::2], m.dq[::2], m.ddq[::2]), seed)


def test_a_delay_is_named_although_the_joints_stick(ur10e: Arm) -> None:
    """Without a delay in the model, the predicted torque comes nearer to that of a stuck joint, which is no torque of the motion."""
    truth = with_effect(ur10e, ArmEffect("time_delay", None, {"delay": 0.012}))
    logs = [on_the_mock(truth, ur10e, seed) for seed in range(1, 6)]
    found = diagnose(ur10e, logs[:4], logs[4:]).answer
    assert [e["effect"] for e in found["effects"]] == ["time_delay"], found["refused"]
    delay = found["effects"][0]["parameters"]["delay"]
    assert abs(delay["value"] - 0.012) < 2 * delay["std"]
    assert delay["std"] == pytest.approx(0.003, abs=0.002)


def test_nothing_is_named_where_the_joints_only_stick(ur10e: Arm) -> None:
    logs = [on_the_mock(ur10e, ur10e, seed) for seed in range(1, 6)]
    found = diagnose(ur10e, logs[:4], logs[4:]).answer
    assert (found["effects"], found["unexplained"], found["refused"]) == ([], [], [])
