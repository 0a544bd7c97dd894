"""A recording behind the driver interface gives every sample once, on a running clock, and refuses commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.replay import ReplayDriver
from logs import read_log
from sim.arm import load_arm
from sim.errors import DeviceError, EndOfRecording

SAMPLES = Path(__file__).resolve().parent.parent.parent / "logs" / "samples"


@pytest.mark.parametrize(("arm", "file"), [("servo6", "servo6_excitation.mcap"), ("ur10e", "ur10e_ur_rtde.csv")])
def test_every_sample_once_on_a_running_clock(arm: str, file: str) -> None:
    model = load_arm(arm)
    log = read_log(SAMPLES / file, model.joint_names)
    with ReplayDriver(log, model) as driver:
        states = [driver.read() for _ in range(len(log))]
        with pytest.raises(EndOfRecording, match="has ended"):
            driver.read()
        with pytest.raises(DeviceError, match="cannot be commanded"):
            driver.send(log.q[0], log.dq[0], 0 * log.q[0])
    np.testing.assert_array_equal([state.q for state in states], log.q)
    np.testing.assert_array_equal([state.t_device for state in states], log.t)
    assert np.all(np.diff([state.t for state in states]) > 0)
