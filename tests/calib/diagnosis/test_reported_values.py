"""Values of an effect in diagnosis.json and in the corrected arm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.claims.diagnosis_sentences import missing, quantity
from calib.diagnosis.answer import entry
from calib.diagnosis.corrected import finite
from calib.diagnosis.diagnose import diagnose
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory
from tests.calib.diagnosis.conftest import at, recording

SPRING = at(2, lambda q, dq: 12.0 * (q - 0.4))


def test_what_the_arm_folder_holds_is_reported_beside_what_was_fitted(ur10e: Arm, tmp_path: Path) -> None:
    found = diagnose(ur10e, [recording(ur10e, seed, SPRING) for seed in (1, 2)], [recording(ur10e, 3, SPRING)])
    found.write(tmp_path, ur10e)
    written = load_arm(tmp_path / "arm")
    reported = json.loads((tmp_path / "diagnosis.json").read_text())["effects"]
    assert [e["effect"] for e in reported] == ["joint_spring"]
    for e in reported:
        own = written.effect(e["effect"], e["joint"])
        assert own is not None
        for name, x in e["parameters"].items():
            assert own.parameters[name] == pytest.approx(x["written"], rel=1e-9)
            assert x["value"] == pytest.approx(x["written"], abs=2 * x["std"])
            # the value also depends on the choice of the effect's law
            assert 0 < x["std_by_law"] < x["std"]


@pytest.mark.slow
def test_of_an_effect_of_the_whole_arm_the_report_and_the_arm_folder_hold_one_number(ur10e: Arm, tmp_path: Path) -> None:
    def pull(motion: Trajectory, tau: np.ndarray) -> np.ndarray:
        pulled = with_effect(ur10e, ArmEffect("tool_force", None, {"force_x": 0.0, "force_y": 25.0, "force_z": 0.0}))
        return predict(pulled, motion) - predict(ur10e, motion)

    found = diagnose(ur10e, [recording(ur10e, seed, pull) for seed in (1, 2)], [recording(ur10e, 3, pull)])
    found.write(tmp_path, ur10e)
    own = load_arm(tmp_path / "arm").effect("tool_force")
    (e,) = json.loads((tmp_path / "diagnosis.json").read_text())["effects"]
    assert own is not None
    for name, x in e["parameters"].items():
        assert own.parameters[name] == pytest.approx(x["value"], rel=1e-9)
        assert np.hypot(own.std[name], x["std_by_law"]) == pytest.approx(x["std"], rel=1e-9)


@pytest.mark.parametrize("std", [np.inf, 1e12, 0.6])
def test_a_number_that_no_recording_shows_has_no_deviation(ur10e: Arm, std: float) -> None:
    item = ArmEffect("payload", None, {"mass": 0.8, "com_x": 0.0, "com_y": 0.01, "com_z": 0.0})
    made = entry(ur10e, item, {"mass": 0.1, "com_x": 0.02, "com_y": 0.0, "com_z": std}, 0.9, 1.0)
    com = made["parameters"]["com_z"]
    assert (com["std"], com["identifiable"]) == (None, False)
    assert quantity(com) == "not identifiable, held at 0 m"
    assert finite(item, {"mass": 0.1, "com_z": std}) == {"mass": 0.1}
    for name in ("mass", "com_x", "com_y"):
        assert "identifiable" not in made["parameters"][name]
    assert "com z not identifiable, held at 0 m" in missing({"effects": [made]})


def test_a_scale_is_known_where_its_logarithm_is(ur10e: Arm) -> None:
    item = ArmEffect("joint_elasticity", ur10e.joint_names[0], {"stiffness": 9e6})
    (stiff,) = entry(ur10e, item, {"stiffness": 8e6}, 0.9, 1.0)["parameters"].values()
    assert stiff["std"] == 8e6
    (unknown,) = entry(ur10e, item, {"stiffness": 9e7}, 0.9, 1.0)["parameters"].values()
    assert unknown["std"] is None
