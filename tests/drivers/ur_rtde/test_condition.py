from __future__ import annotations

import pytest

from drivers.ur_rtde.condition import condition, other_program
from sim.joint_state import Status

HEALTHY = {
    "safety_status_bits": (1,), "robot_mode": (7,), "runtime_state": (2,), "target_speed_fraction": (1.0,), "speed_scaling": (1.0,),
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "status", "word"),
    [
        ({}, Status.RUNNING, ""),
        ({"safety_status_bits": (2,)}, Status.IDLE, "reduced mode"),
        ({"safety_status_bits": (0,)}, Status.FAULT, "unknown"),
        ({"safety_status_bits": (1 | 1 << 10,)}, Status.PROTECTIVE_STOP, "safety"),
        ({"safety_status_bits": (1 << 2 | 1 << 10,)}, Status.PROTECTIVE_STOP, "Unlock"),
        ({"safety_status_bits": (1 << 4,)}, Status.PROTECTIVE_STOP, "guard"),
        ({"safety_status_bits": (1 << 6 | 1 << 7,)}, Status.EMERGENCY_STOP, "button"),
        ({"safety_status_bits": (1 << 8,)}, Status.FAULT, "limit"),
        ({"safety_status_bits": (1 << 9 | 1 << 2,)}, Status.FAULT, "fault"),
        ({"robot_mode": (5,)}, Status.IDLE, "brakes"),
        ({"robot_mode": (99,)}, Status.IDLE, "99"),
        ({"runtime_state": (1,)}, Status.IDLE, "stopped"),
        ({"runtime_state": (4,)}, Status.IDLE, "paused"),
        ({"target_speed_fraction": (0.4,)}, Status.IDLE, "slider"),
        ({"speed_scaling": (0.5,)}, Status.IDLE, "50 %"),
    ],
)
def test_every_state_has_a_status_and_a_remedy(change: dict[str, tuple[float, ...]], status: Status, word: str) -> None:
    found, detail = condition({**HEALTHY, **change}, commanded=True)
    assert found is status
    assert word in detail


def test_before_commands_the_program_need_not_run() -> None:
    assert condition({**HEALTHY, "runtime_state": (1,)}, commanded=False)[0] is Status.RUNNING


def test_a_speed_that_is_not_a_number_is_not_full_speed() -> None:
    assert condition({**HEALTHY, "speed_scaling": (float("nan"),)}, commanded=True)[0] is Status.IDLE


def test_a_cell_may_lift_reduced_mode_and_scaling_and_no_stop() -> None:
    lifted = {**HEALTHY, "safety_status_bits": (2,), "speed_scaling": (0.0,)}
    assert condition(lifted, commanded=True, assumed=("reduced-mode", "speed-scaling"))[0] is Status.RUNNING
    stopped = {**HEALTHY, "safety_status_bits": (2 | 1 << 2,)}
    assert condition(stopped, commanded=True, assumed=("reduced-mode", "speed-scaling"))[0] is Status.PROTECTIVE_STOP


def test_an_idle_controller_may_report_any_scaling() -> None:
    assert condition({**HEALTHY, "runtime_state": (1,), "speed_scaling": (0.0,)}, commanded=False)[0] is Status.RUNNING


@pytest.mark.parametrize(
    ("state", "word"), [(0, "stopping"), (2, "playing"), (3, "pausing"), (4, "paused"), (5, "resuming"), (9, "9")]
)
def test_before_control_is_taken_every_program_that_is_not_stopped_counts(state: int, word: str) -> None:
    status, text, remedy = other_program(state, "palletise.urp")
    assert status is Status.IDLE
    assert word in text
    assert "palletise.urp" in text
    assert "left alone" in remedy
