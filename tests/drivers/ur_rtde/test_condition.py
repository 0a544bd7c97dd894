from __future__ import annotations

import pytest

from drivers.ur_rtde.condition import condition
from sim.joint_state import Status

HEALTHY = {
    "safety_status_bits": (1,), "robot_mode": (7,), "runtime_state": (2,), "target_speed_fraction": (1.0,), "speed_scaling": (1.0,),
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "status", "word"),
    [
        ({}, Status.RUNNING, ""),
        ({"safety_status_bits": (2,)}, Status.RUNNING, ""),
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
        ({"speed_scaling": (0.5,)}, Status.IDLE, "100 %"),
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
