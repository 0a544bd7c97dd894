"""A real controller, if CALIB_UR_HOST names one: readings, preflight, control program. Commands no motion."""

from __future__ import annotations

import os

import numpy as np
import pytest

from drivers.preflight import preflight
from drivers.ur_rtde.driver import UrDriver
from drivers.ur_rtde.options import UrOptions
from sim.arm import load_arm
from sim.cell import load_cell
from sim.joint_state import Status

HOST = os.environ.get("CALIB_UR_HOST", "")
pytestmark = pytest.mark.skipif(not HOST, reason="no UR controller: set CALIB_UR_HOST to its address, CALIB_UR_ARM to its arm")


def test_a_real_controller_passes_the_preflight_and_stands_still() -> None:
    arm = load_arm(os.environ.get("CALIB_UR_ARM", "ur10e"))
    with UrDriver(arm, UrOptions(host=HOST), assume=("serial-as-found",)) as driver:
        failed = [
            f"{c.name}: {c.detail}; {c.remedy}" for c in preflight(driver, load_cell("emulated-ur10e"), 2.0) if c.ok is False
        ]
        assert failed == []
        states = [driver.read() for _ in range(round(driver.rate))]
        assert {s.status for s in states} == {Status.RUNNING}
        assert np.max(np.abs([s.dq for s in states])) < 0.02
        assert driver.link.lost == 0
