"""The stop itself under further faults: it runs once, from the last sample sent, whatever the device or a reading does."""

from __future__ import annotations

import numpy as np
import pytest

from safety.clear import ClearedTrajectory
from safety.collision import Clearance
from safety.run_progress import Cycle
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import DeviceError
from sim.joint_state import JointState
from tests.safety.guarded import AT, check_stop, guard_of, hot, stopped_by
from tests.safety.perfect import PerfectDriver, simulated

CHANNELS = ("q", "dq", "tau", "current", "temperature")


@pytest.mark.parametrize("error", [DeviceError("the controller answered with an error"), OSError(5, "input/output error")])
def test_a_device_that_refuses_its_stop_changes_nothing_of_ours(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, error: Exception
) -> None:
    driver.fault = lambda state, k: hot(state) if k == AT else state

    def refuse() -> None:
        driver.stops += 1
        raise error

    driver.stop = refuse  # type: ignore[method-assign]
    stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
    assert stop.trip.quantity == "temperature"
    assert f"the device did not accept the stop command: {error}" in str(stop)
    check_stop(driver, cleared, arm, stop, AT)


def test_a_stop_after_a_failing_view_begins_at_the_last_sample_that_was_sent(
    driver: PerfectDriver, arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory
) -> None:
    def watch(cycle: Cycle) -> None:
        if cycle.k == AT:
            raise OSError("the terminal is closed")

    stopped_by(guard_of(driver, arm, cell, clearance, watch=watch), cleared)
    sent = np.array([q for q, _ in driver.sent])[AT - 5 :]
    assert np.all(np.abs(np.diff(sent, 2, axis=0)) * 500**2 <= arm.ddq_max * 1.1)


@pytest.mark.parametrize("joints", [0, 5])
def test_a_reading_with_joints_missing_ends_in_a_stop(
    arm: Arm, cell: Cell, clearance: Clearance, cleared: ClearedTrajectory, joints: int
) -> None:
    """Once: our own stop follows. For ever: the device's, and the report names the reading."""

    def missing(state: JointState) -> JointState:
        return JointState(state.t, state.t_device, *(getattr(state, name)[:joints] for name in CHANNELS))

    for until, by_device in ((AT + 1, False), (10**9, True)):
        driver = simulated(cell, arm)
        driver.connect()
        driver.fault = lambda s, k, until=until: missing(s) if AT <= k < until else s  # type: ignore[misc]
        stop = stopped_by(guard_of(driver, arm, cell, clearance), cleared)
        assert stop.trip.quantity == "reading"
        assert ("device's own stop" in stop.standstill.stop) == by_device
