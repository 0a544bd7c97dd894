"""Under computed torque, tracking improves with the accuracy of the controller's model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.known_truth import fourier_motion
from calib.report.tracking import write
from calib.validation.tracking import moved_by, tracked
from sim.arm import ArmEffect, load_arm
from sim.effects import with_effect

ARM = load_arm("ur10e")
MOTION = fourier_motion(ARM, 3, 4.0, 500.0)


def test_the_true_model_leaves_less_to_the_feedback_than_one_without_the_payload() -> None:
    truth = with_effect(ARM, ArmEffect("payload", None, {"mass": 2.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05}))
    before, after = (tracked(truth, model, ARM, MOTION) for model in (ARM, truth))
    assert after.rms < 0.1 * before.rms
    assert np.sqrt(np.mean(after.feedback**2)) < 0.5 * np.sqrt(np.mean(before.feedback**2))
    assert after.as_dict()["error_mrad"] == 1e3 * after.rms


def test_what_only_the_readings_have_is_not_commanded() -> None:
    truth = with_effect(ARM, ArmEffect("torque_offset", "elbow_joint", {"offset": 4.0}))
    assert all(e.effect != "torque_offset" for e in moved_by(truth).effects)
    assert tracked(truth, truth, ARM, MOTION).rms == tracked(truth, ARM, ARM, MOTION).rms


def test_the_page_shows_every_model_and_what_was_hidden(tmp_path: Path) -> None:
    truth = with_effect(ARM, ArmEffect("payload", None, {"mass": 2.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05}))
    followed = {
        name: tracked(truth, model, ARM, MOTION)
        for name, model in (("nominal", ARM), ("calibrated", truth), ("true arm", truth))
    }
    hidden = [["payload", "whole arm", "mass", "2 kg", "2.0 ± 0.1 kg"]]
    shown = write(tmp_path, ARM.name, ARM.joint_names, followed, "payload at the whole arm", hidden).read_text(encoding="utf-8")
    for words in (f"{1e3 * followed['nominal'].rms:.2g} mrad", "2.0 ± 0.1 kg", *ARM.joint_names, "<svg"):
        assert words in shown
