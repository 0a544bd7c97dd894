"""Loads that are put on a real arm in motion, and stops that are none: real recordings, with the load's torque added to the measured one."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.identification.identify import identify
from calib.watch.events import Kind, WatchEvent
from calib.watch.watcher import Watcher
from logs import read_log
from logs.log import Log
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState
from sim.prediction import predict
from sim.trajectory import Trajectory
from tests.calib.watch.conftest import LOAD

DATA = os.environ.get("ARM_CALIB_DATA")
pytestmark = pytest.mark.skipif(DATA is None, reason="real recordings are not here: set ARM_CALIB_DATA to their folder")


def recording(name: str) -> Log:
    return read_log(Path(DATA or "") / f"ur10e/excitation_{name}.csv")


@pytest.fixture(scope="module")
def arm() -> Arm:
    ur10e = load_arm("ur10e")
    return identify(ur10e, [recording(name) for name in ("20s_8h", "20s_10h", "30s_12h")]).arm


def events(arm: Arm, log: Log, extra: np.ndarray, until: float) -> list[WatchEvent]:
    watcher, out, nan = Watcher(arm, 1 / log.period), [], np.full(arm.n, np.nan)
    assert arm.torque_constant is not None
    tau = log.current * arm.torque_constant + extra
    for k in range(int(np.searchsorted(log.t, until))):
        out += watcher.add(JointState(log.t[k], log.t[k], log.q[k], log.dq[k], tau[k], log.current[k], nan))
    return out


def load_torque(arm: Arm, log: Log, mass: float) -> np.ndarray:
    """(N, n) N m of a mass 60 mm in front of the flange."""
    dq = np.nan_to_num(log.dq)
    ddq = np.gradient(dq, log.t, axis=0)
    kernel = np.ones(9) / 9
    ddq = np.stack([np.convolve(x, kernel, "same") for x in ddq.T], axis=1)

    motion = Trajectory(log.t, log.q, dq, ddq)
    bare = replace(arm, effects=())
    item = ArmEffect("payload", None, LOAD | {"mass": mass, "com_y": 0.0, "com_z": 0.06})
    return predict(with_effect(bare, item), motion) - predict(bare, motion)


@pytest.mark.parametrize(("name", "mass", "on"), [("50s_12h", 1.5, 24.0), ("50s_12h", 0.8, 32.0), ("40s_12h", 1.5, 20.0)])
def test_a_load_whose_jump_is_missed_is_not_reported_while_the_estimate_lags(
    arm: Arm, name: str, mass: float, on: float
) -> None:
    log = recording(name)
    extra = load_torque(arm, log, mass) * (log.t > on)[:, None]
    found = [e for e in events(arm, log, extra, on + 12.0) if e.kind in (Kind.PAYLOAD_ATTACHED, Kind.PAYLOAD_CHANGED)]
    assert found
    assert found[0].t > on
    reported = found[0].size["mass"]
    assert abs(reported.value - mass) < 2.6 * reported.std
    assert reported.std < 0.2 * mass


def test_a_stop_after_a_short_move_is_no_load(arm: Arm) -> None:
    """Two healthy recordings, one after the other: between them lies a move of 0.4 s that stops abruptly."""
    first, second = recording("50s_12h"), recording("30s_12h")
    later = second.t - second.t[0] + first.t[-1] + 0.01
    arrays = {key: np.concatenate([getattr(first, key), getattr(second, key)]) for key in ("q", "dq", "tau", "current")}
    nan = np.full(arrays["q"].shape, np.nan)
    t = np.concatenate([first.t, later])
    both = replace(first, t=t, t_host=t, temperature=nan, q_cmd=nan, dq_cmd=nan, tau_cmd=nan, **arrays)
    found = [e.kind for e in events(arm, both, np.zeros(arrays["q"].shape), 80.0)]
    assert not {Kind.PAYLOAD_ATTACHED, Kind.PAYLOAD_CHANGED, Kind.UNEXPECTED_CONTACT} & set(found)
