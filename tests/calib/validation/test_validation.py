"""Validation by torque and forward simulation: the right arm predicts the measurement, a wrong one shows its fault."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.known_truth import recorded_on_mock
from calib import main as program
from calib.identification.calibrated import write_calibrated
from calib.identification.identify import identify
from calib.identification.known import FILE, Known
from calib.validation.validate import validate
from calib.verdict import Verdict
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import ConfigError
from tests.calib.conftest import fourier_motion, recorded, varied


def test_the_right_arm_leaves_the_noise(ur5e: Arm) -> None:
    log = recorded(ur5e, fourier_motion(ur5e, 1, seconds=10.0))
    check = validate(ur5e, [log]).checks[0]
    assert np.all(check.unfiltered < 1.15 * np.array(ur5e.sensors.torque_noise))
    assert np.all(check.residual < check.unfiltered)
    assert check.short is not None
    assert np.all(check.short.angle < 0.12 * check.short.travel)


def test_a_joint_that_sticks_at_its_reversals_is_compared_while_it_slides() -> None:
    arm = load_arm("ur10e")
    moved = fourier_motion(arm, 2, seconds=10.0)
    slow = replace(moved, t=3 * moved.t, dq=moved.dq / 3, ddq=moved.ddq / 9)
    log = recorded_on_mock(arm, arm, slow)
    found = validate(arm, [log], forward=False, most=0.15)
    check = found.checks[0]
    assert np.max(check.residual / check.signal) > 0.15
    assert np.all(check.sliding < 0.9 * check.residual)
    assert found.assessment.verdict is Verdict.GOOD
    wrong = with_effect(arm, ArmEffect("coulomb_friction", "wrist_2_joint", {"coulomb": 1.2}))
    assert validate(wrong, [log], forward=False, most=0.15).assessment.verdict is Verdict.POOR


def test_a_wrong_joint_is_the_one_that_is_off(ur5e: Arm) -> None:
    truth = with_effect(ur5e, ArmEffect("viscous_friction", "wrist_2_joint", {"viscous": 8.0}))
    log = recorded(truth, fourier_motion(ur5e, 1, seconds=10.0))
    found = validate(ur5e, [log])
    check = found.checks[0]
    assert np.argmax(check.residual / check.signal) == 4
    assert check.short is not None
    assert np.argmax(check.short.angle) == 4
    assert "wrist_2_joint" in found.outcome
    right = validate(truth, [log]).checks[0]
    assert right.short is not None
    assert right.short.angle[4] < 0.3 * check.short.angle[4]


def test_sensor_effects_do_not_enter_the_simulation(ur5e: Arm) -> None:
    truth = ur5e
    for joint in ur5e.joint_names:
        truth = with_effect(truth, ArmEffect("torque_offset", joint, {"offset": 2.0}))
    log = recorded(truth, fourier_motion(ur5e, 1, seconds=6.0), noise=0.2)
    check = validate(truth, [log]).checks[0]
    assert check.short is not None
    assert np.all(check.short.angle < 0.05 * check.short.travel + 1e-3)


def test_a_joint_that_hardly_moves_is_not_compared(ur5e: Arm) -> None:
    """Held joints give way by about a milliradian at any torque within their dry friction, and do not affect the verdict."""
    moved = fourier_motion(ur5e, 1, seconds=8.0)
    only = np.where(np.arange(6) == 2, 1.0, 5e-3)
    log = recorded(ur5e, replace(moved, q=moved.q[0] + only * (moved.q - moved.q[0]), dq=only * moved.dq, ddq=only * moved.ddq))
    push = 20.0 * (1 + np.sin(3.0 * log.t[:, None])) * (only < 1)
    found = validate(ur5e, [replace(log, tau=log.tau + push)], forward=False)
    assert found.assessment.verdict.value == "good"
    assert [v.value for v in found.assessment.verdicts].count("nothing compared") == 5


def test_a_log_that_stands_still_compares_nothing(ur5e: Arm) -> None:
    motion = fourier_motion(ur5e, 1, seconds=4.0)
    log = recorded(ur5e, motion)
    still = replace(log, q=np.repeat(log.q[:1], len(log), axis=0))
    found = validate(ur5e, [still])
    assert "nothing compared" in found.outcome
    assert np.all(np.isnan(found.checks[0].residual))


def test_the_command_writes_what_design_says(ur5e: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ur10e = load_arm("ur10e")
    log = recorded(ur10e, fourier_motion(ur5e, 1, seconds=4.0))
    file = tmp_path / "log.csv"
    columns = (
        [f"actual_q_{j}" for j in range(6)] + [f"actual_qd_{j}" for j in range(6)] + [f"actual_current_{j}" for j in range(6)]
    )
    with file.open("w") as stream:
        stream.write("timestamp," + ",".join(columns) + "\n")
        for t, q, dq, tau in zip(log.t, log.q, log.dq, log.tau, strict=True):
            stream.write(",".join(repr(float(x)) for x in (t, *q, *dq, *(tau / ur10e.torque_constant))) + "\n")
    monkeypatch.chdir(tmp_path)
    assert program.main(["validate", "ur5e", str(file)]) == 2  # the ur5e states no torque constant
    assert program.main(["validate", "ur10e", str(file), "--no-forward", "--out", "out"]) == 0
    table = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert table["schema"] == "validation/1"
    assert table["verdict"] == "good"
    assert [row["verdict"] for row in table["joint_verdicts"]] == ["good"] * 6
    with (tmp_path / "out" / "prediction.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    names = [f"{k}_{j}" for k in ("tau", "tau_hat") for j in table["joints"]]
    assert list(rows[0]) == ["t", *names]
    assert len(rows) > 700


def test_the_forward_simulation_stays_within_its_stated_bound(ur5e: Arm, tmp_path: Path) -> None:
    truth = varied(ur5e, 3)
    logs = [recorded(truth, fourier_motion(ur5e, k), k) for k in (1, 2, 3)]
    found = identify(ur5e, logs[:2])
    arm = write_calibrated(tmp_path / "arm", ur5e, found.arm)
    found.known.write(tmp_path / "arm", found.model)
    check = validate(arm, logs[2:]).checks[0]
    assert check.bound is not None
    assert check.within_bound is not None
    assert check.short is not None
    assert check.within_bound.all()
    assert np.all(check.bound < 5 * check.short.angle)
    far = replace(arm, tree=replace(arm.tree, mass=arm.tree.mass * 1.2))
    worse = validate(far, logs[2:])
    assert worse.checks[0].within_bound is not None
    assert not worse.checks[0].within_bound.all()
    assert "beyond the stated bound: " in worse.outcome


def test_a_nominal_arm_has_the_bound_of_its_own_tolerances(ur5e: Arm) -> None:
    known = Known.of_arm(ur5e)
    assert "arm's file states" in known.source
    log = recorded(varied(ur5e, 4, relative=0.02), fourier_motion(ur5e, 1, seconds=10.0))
    check = validate(ur5e, [log]).checks[0]
    assert check.within_bound is not None
    assert check.within_bound.all()


def test_an_uncertainty_of_another_arm_is_refused(ur5e: Arm, tmp_path: Path) -> None:
    found = identify(ur5e, [recorded(ur5e, fourier_motion(ur5e, 1), 1)])
    arm = write_calibrated(tmp_path / "arm", ur5e, found.arm)
    found.known.write(tmp_path / "arm", found.model)
    file = tmp_path / "arm" / FILE
    file.write_text(file.read_text().replace("mcx_2", "mcx_7"))
    with pytest.raises(ConfigError, match="other parameters than ur5e; identify the arm again"):
        validate(arm, [recorded(ur5e, fourier_motion(ur5e, 1, seconds=5.0))])
    file.write_text("{")
    with pytest.raises(ConfigError, match="not a file that `calib identify` wrote"):
        Known.of_arm(arm)
