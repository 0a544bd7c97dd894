"""Validation: a right arm predicts what was measured, a wrong one shows where it is wrong, by torque and by forward simulation."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import main as program
from calib.validation import validate
from sim.arm import Arm, ArmEffect
from sim.effects import with_effect
from tests.calib.conftest import fourier_motion, recorded


def test_the_right_arm_leaves_the_noise(ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0))
    check = validate(ur5e, [log]).checks[0]
    assert np.all(check.unfiltered < 1.15 * np.array(ur5e.sensors.torque_noise))
    assert np.all(check.residual < check.unfiltered)
    assert check.forward is not None
    assert np.all(check.forward < 0.12 * check.travel)


def test_a_wrong_joint_is_the_one_that_is_off(ur5e: Arm) -> None:
    truth = with_effect(ur5e, ArmEffect("viscous_friction", "wrist_2_joint", {"viscous": 8.0}))
    log = recorded(truth, fourier_motion(ur5e, 1, seconds=10.0))
    found = validate(ur5e, [log])
    check = found.checks[0]
    assert np.argmax(check.residual / check.signal) == 4
    assert check.forward is not None
    assert np.argmax(check.forward) == 4
    assert "wrist_2_joint" in found.outcome
    right = validate(truth, [log]).checks[0]
    assert right.forward is not None
    assert right.forward[4] < 0.3 * check.forward[4]


def test_sensor_effects_do_not_enter_the_simulation(ur5e: Arm) -> None:
    truth = ur5e
    for joint in ur5e.joint_names:
        truth = with_effect(truth, ArmEffect("torque_offset", joint, {"offset": 2.0}))
    log = recorded(truth, fourier_motion(ur5e, 1, seconds=6.0), noise=0.2)
    check = validate(truth, [log]).checks[0]
    assert check.forward is not None
    assert np.all(check.forward < 0.05 * check.travel + 1e-3)


def test_a_log_that_stands_still_compares_nothing(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1, seconds=4.0)
    log = recorded(ur5e, motion)
    still = replace(log, q=np.repeat(log.q[:1], len(log), axis=0))
    found = validate(ur5e, [still])
    assert "nothing was compared" in found.outcome
    assert np.all(np.isnan(found.checks[0].residual))


def test_the_command_writes_what_design_says(ur5e: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, seconds=4.0))
    file = tmp_path / "log.csv"
    columns = (
        [f"actual_q_{j}" for j in range(6)] + [f"actual_qd_{j}" for j in range(6)] + [f"actual_current_{j}" for j in range(6)]
    )
    with file.open("w") as stream:
        stream.write("timestamp," + ",".join(columns) + "\n")
        for t, q, dq, tau in zip(log.t, log.q, log.dq, log.tau, strict=True):
            stream.write(",".join(repr(float(x)) for x in (t, *q, *dq, *(tau / 10.0))) + "\n")
    monkeypatch.chdir(tmp_path)
    assert program.main(["validate", "ur5e", str(file)]) == 2  # the ur5e states no torque constant
    assert program.main(["validate", "ur10e", str(file), "--no-forward", "--out", "out"]) == 0
    table = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert table["schema"] == "validation/1"
    with (tmp_path / "out" / "prediction.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    names = [f"{k}_{j}" for k in ("tau", "tau_hat") for j in table["joints"]]
    assert list(rows[0]) == ["t", *names]
    assert len(rows) > 700
