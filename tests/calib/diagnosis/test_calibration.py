"""A diagnosis lists every parameter that the refit changes in the corrected arm, with the value that is written."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.known_truth import fourier_motion, recorded
from calib.diagnosis.calibration import calibration
from calib.diagnosis.corrected import correction
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured
from calib.diagnosis.selection import started
from sim.arm import Arm


def test_reflected_inertias_that_are_all_off_are_listed_as_they_are_written(ur10e: Arm) -> None:
    heavier = tuple(
        replace(e, parameters={"inertia": 1.6 * e.parameters["inertia"]}) if e.effect == "rotor_inertia" else e
        for e in ur10e.effects
    )
    truth = replace(ur10e, effects=heavier)
    logs = [recorded(truth, fourier_motion(ur10e, seed, 12.0, 125.0), seed, memory=0.0) for seed in (3, 4)]
    refit = started([measured(log, ur10e) for log in logs], Hypothesis.nominal(ur10e))
    listed = {m.joint: m for m in calibration(refit) if m.name == "reflected inertia"}
    assert set(listed) == set(ur10e.joint_names)
    for e in correction(refit).effects:
        if e.effect == "rotor_inertia":
            moved = listed[e.joint]
            assert moved.after == pytest.approx(e.parameters["inertia"])
            assert moved.after == pytest.approx(1.6 * moved.before, rel=0.1)
