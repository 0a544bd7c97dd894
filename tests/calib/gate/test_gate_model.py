"""Errors of the model that are no fault of a recording: a load, a tilted base, a pull, unknown masses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.exam import cases
from benchmarks.exam.cases import Case, listed, make
from benchmarks.wrong_data import arm, base, changes, family
from calib.gate import gate
from calib.gate.fit import GravityFit
from calib.gate.scale import causes
from calib.gate.signals import signals
from logs import read_log
from sim.arm import Arm, load_arm


def test_a_bad_model_is_the_models_fault() -> None:
    """No friction, wrong masses, placeholder limits or no masses at all: no unit explains that, and nothing is refused."""
    of, log = base("servo6 2")
    tree = of.tree
    for change in (
        {"effects": ()},
        {"tau_max": np.full(of.n, 0.01)},
        {"dq_max": np.full(of.n, 0.1)},
        {"tree": replace(tree, mass=tree.mass * np.array([3.0, 0.4, 1.8, 2.5, 0.5, 2.0]))},
        {"tree": replace(tree, mass=tree.mass * 0, inertia=tree.inertia * 0)},
        {"tree": replace(tree, com=tree.com * 1.5 + 0.02)},
    ):
        changed: Arm = replace(of, **change)
        assert gate(changed, [log]).refusal is None, change


def test_a_payload_is_no_wrong_recording() -> None:
    from benchmarks.known_truth import fourier_motion, recorded
    from benchmarks.wrong_data import within
    from sim.arm import ArmEffect
    from sim.effects import with_effect

    of = arm("ur10e")
    for mass in (2.0, 6.0):
        heavy = with_effect(of, ArmEffect("payload", None, {"mass": mass, "com_x": 0.02, "com_y": 0.05, "com_z": 0.08}))
        log = recorded(heavy, within(of, fourier_motion(of, 31, 20.0, 100.0)), 3)
        assert gate(of, [log], family=family).refusal is None


@pytest.mark.parametrize(
    ("name", "motion", "effect", "parameters"),
    [
        ("servo6", 90, "payload", {"mass": 0.4, "com_x": 0.0, "com_y": 0.0, "com_z": 0.05}),
        ("ur3e", 90, "payload", {"mass": 2.0, "com_x": 0.03, "com_y": 0.0, "com_z": 0.06}),
        ("servo6", 90, "base_tilt", {"roll": 0.15, "pitch": -0.1}),
        ("ur3e", 90, "base_tilt", {"roll": 0.15, "pitch": -0.1}),
        ("servo6", 113, "tool_force", {"force_x": 2.42, "force_y": -2.04, "force_z": 2.45}),
        ("servo6", 149, "tool_force", {"force_x": -0.32, "force_y": -2.38, "force_z": 3.2}),
    ],
)
def test_a_load_a_tilted_base_or_a_pull_is_neither_another_arm_nor_another_column(
    name: str, motion: int, effect: str, parameters: dict[str, float]
) -> None:
    """Checked against every arm in the package: a light loaded arm resembles a heavier one, a tilted base a reversed joint."""
    from benchmarks.known_truth import fourier_motion, recorded, varied
    from benchmarks.wrong_data import within
    from calib.gate.commands import family as shipped
    from sim.arm import ArmEffect
    from sim.effects import with_effect

    of = arm(name)
    truth = with_effect(varied(of, 0, 0.08), ArmEffect(effect, None, parameters))
    log = recorded(truth, within(of, fourier_motion(of, motion, 16.0, 100.0)), 0)
    assert gate(of, [log], family=lambda: shipped(None)).refusal is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "log"),
    [
        # joints moved one after the other: a heavier arm explains the load as well as a load does
        (Case(6, "single", "ur10e", 3, True, 7006, (("payload", -1),)), "friction"),
        # a strong pull at the tool: with free scales, a load of any mass fits
        (listed(76, 26112811)[75], "excitation"),
        # a wrist that the motor of the joint before it turns backwards: the residual of its reversed readings is 11 % smaller
        (listed(33, 26113071)[32], "validation"),
    ],
)
def test_a_recording_of_an_exam_that_was_refused_is_the_arms(
    tmp_path: Path, case: Case, log: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Recordings of blind exams that were once refused. The first fit scales every joint freely, so loads are hard to see."""
    from calib.gate.commands import family as shipped

    write = cases.write

    def up_to_it(file: Path, *rest: Any) -> None:
        write(file, *rest)
        if file.stem == log:
            raise InterruptedError  # the recordings after it are not needed

    monkeypatch.setattr(cases, "write", up_to_it)
    with pytest.raises(InterruptedError):
        make(case, tmp_path)
    of = load_arm(tmp_path / "arm.xml")
    assert gate(of, [read_log(tmp_path / f"{log}.mcap", of.joint_names)], family=lambda: shipped(None)).refusal is None


@pytest.mark.parametrize("name", ["servo6 sample", "ur5e 1"])
def test_exchanged_wrists_are_no_load(name: str) -> None:
    """Light joints with exchanged readings gain little. A load that fits about as badly must not excuse them."""
    of, log = base(name)
    what = "joints exchanged, wrist_2_joint,wrist_3_joint"
    wrong, words = changes(of)[what](log, of, np.random.default_rng(0))
    found = gate(of, [wrong], family=family)
    assert any(word in (found.refusal or "") for word in words)


def test_masses_that_nobody_knows_tell_nothing() -> None:
    of, log = base("servo6 2")
    unknown = replace(of, prior=of.prior.model_copy(update={"numbers": "unknown"}))
    assert gate(unknown, [replace(log, tau=log.tau * 30)], family=family).refusal is None
    assert gate(unknown, [replace(log, dq=np.degrees(log.dq))]).refusal


def test_an_effect_in_a_part_of_the_recording_is_not_exchanged_columns() -> None:
    """An effect that the model does not have, in the last fifth of the recording, is not reported as exchanged columns."""
    of, log = base("servo6 2")
    still = np.arange(len(log)) < 0.8 * len(log)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        ripple = 0.3 * log.tau.std(axis=0) * np.sin(rng.uniform(5, 20, of.n) * log.q + rng.uniform(0, 6, of.n))
        read = replace(log, tau=log.tau + np.where(still[:, None], 0.0, ripple))
        assert gate(of, [read], family=family).refusal is None


def test_a_joint_without_dry_friction_is_no_other_unit() -> None:
    from benchmarks.known_truth import fourier_motion, recorded
    from benchmarks.wrong_data import within
    from sim.arm import ArmEffect
    from sim.effects import with_effect

    of = arm("ur5e")
    smooth = with_effect(of, ArmEffect("coulomb_friction", "wrist_3_joint", {"coulomb": 0.0}))
    log = recorded(smooth, within(of, fourier_motion(of, 31, 10.0, 100.0)), 3)
    assert gate(of, [log], family=family).refusal is None


@pytest.mark.parametrize(("dry", "named"), [(2e-5, False), (2e-2, True)])
def test_dry_friction_below_what_nothing_explains_names_no_joint(dry: float, named: bool) -> None:
    """A joint without dry friction still has an estimate of it, which may be any multiple of that of other joints."""
    of, log = base("servo6 2")
    s = signals([log], [log.tau])
    one = np.ones(of.n)
    every = np.array([1.0, 1.0, 1.0, 1.0, 20.0, 1.0]) * dry * of.tau_max
    fit = GravityFit(1e-3 * of.tau_max, of.tau_max / 10, one, 0.02 * one, every, 0.0 * one)
    found = causes(of, s, fit, np.zeros(of.n, dtype=bool), True)
    assert [cause.sentence.split(" is ")[0] for cause in found] == [f"the torque (or current) of {of.joint_names[4]}"] * named
