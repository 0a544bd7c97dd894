"""Drivers against emulated devices, in real time."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent
# tests of a device behind a socket or a pseudo-terminal or in another process: deadlines run on while something else has the
# processor
WALL_CLOCK = (
    "can_servo/test_listener.py",
    "can_servo/test_monitor_process.py",
    "can_servo/test_wire.py",
    "ur_rtde/test_ahead.py",
    "ur_rtde/test_capture.py",
    "ur_rtde/test_command_process.py",
    "ur_rtde/test_driver.py",
    "ur_rtde/test_guarded.py",
    "ur_rtde/test_hazards.py",
    "ur_rtde/test_identity.py",
    "ur_rtde/test_listen.py",
    "ur_rtde/test_own_arm.py",
    "ur_rtde/test_programs.py",
    "ur_rtde/test_recorded.py",
    "ur_rtde/test_robot_api.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Rerun tests on the wall clock, which miss a deadline if another process has the processor.

    The summary names those that were rerun.
    """
    for item in items:
        if item.path.is_relative_to(HERE) and item.path.relative_to(HERE).as_posix() in WALL_CLOCK:
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=2))
