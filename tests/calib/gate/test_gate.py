"""Recordings with wrong units, signs, columns, clocks or arms are refused with their cause; good ones pass."""

from __future__ import annotations

import json
import sys
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.wrong_data import BASES, arm, base, cases, changes, family, named_first
from calib.gate import gate
from calib.gate.commands import read_as
from calib.gate.fit import fitted, model_torque
from calib.gate.signals import signals
from logs import read_log
from logs.log import Log

SHORT = 40
ALL = list(changes(arm("servo6")))
UNDONE = [what for what in ALL if what != "gravity taken off"]  # no correction recovers it


@pytest.mark.parametrize("name", BASES)
def test_good_recordings_pass(name: str) -> None:
    of, log = base(name)
    found = gate(of, [log], family=family)
    assert found.refusal is None, found.refusal
    assert all(check.ok for check in found.checks)


def test_physics_is_asked_once_about_the_same_arm_and_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    module, asked = sys.modules["calib.gate.gate"], []
    monkeypatch.setattr(module, "_kept", OrderedDict())
    monkeypatch.setattr(module, "_physics", lambda arm, logs, family: asked.append(arm) or [])
    of, log = base(BASES[0])
    same = replace(log, q=log.q.copy(), findings=("read again",))
    for arm_asked, read in ((of, log), (of, same), (replace(of), log), (of, replace(log, tau=-log.tau))):
        gate(arm_asked, [read])
    assert len(asked) == 3
    for k in range(20):
        gate(of, [replace(log, tau=log.tau + k)])
    assert len(module._kept) == 16


@pytest.mark.slow
def test_wrong_recordings_do_not_and_the_cause_comes_first_in_nine_of_ten() -> None:
    """The first SHORT cases of the corpus; `test_the_whole_corpus` runs all of it."""
    named = 0
    for case in cases()[:SHORT]:
        found = gate(case.arm, case.logs, family=family)
        assert found.refusal, case.name
        named += named_first(case, found)
    assert named >= 0.9 * SHORT


@pytest.mark.slow
def test_the_whole_corpus() -> None:
    passed, named = [], 0
    for case in cases():
        found = gate(case.arm, case.logs, family=family)
        if found.refusal is None:
            passed.append(case.name)
        named += named_first(case, found)
    assert not passed
    assert named >= 0.9 * len(cases())


@pytest.mark.parametrize(
    "what",
    [what if k % 5 == 0 or ", " not in what else pytest.param(what, marks=pytest.mark.slow) for k, what in enumerate(UNDONE)],
)
def test_what_the_first_cause_says_makes_the_recording_good(what: str) -> None:
    """Applying the corrections of the first cause, one after the other, undoes every single corruption."""
    of, log = base("servo6 2")
    wrong, _ = changes(of)[what](log, of, np.random.default_rng(5))
    words: list[str] = []
    for _ in range(4):
        read = read_as(wrong, words)
        found = gate(of, [read])
        if found.refusal is None:
            break
        words += [c.word(of.joint_names) for c in found.causes[0].corrections]
    assert found.refusal is None, (what, words, found.refusal)
    assert json.loads(read.metadata["assumed"]) == words


def test_currents_without_a_torque_constant_pass_and_a_reversed_one_does_not() -> None:
    of, log = base("servo6 2")
    current = replace(log, current=log.tau / np.array([8.0, 9.0, 7.0, 3.0, 3.0, 2.5]), tau=np.full(log.tau.shape, np.nan))
    assert gate(of, [current]).refusal is None
    sign = np.array([1, 1, -1, 1, 1, 1])
    found = gate(of, [replace(current, current=current.current * sign)])
    assert "elbow_joint" in (found.refusal or "")


def test_the_torque_constant_that_currents_tell_comes_with_its_interval() -> None:
    of, log = base("servo6 2")
    found = gate(of, [replace(log, tau=log.tau / 9.0)])
    assert "torque constant" in (found.refusal or "")
    low, high = found.causes[0].interval or (0, 0)
    assert low < 1 / 9.0 < high
    assert high / low < 1.5


def test_a_standing_or_short_or_empty_recording_is_no_reason_to_refuse_by_the_model() -> None:
    of, log = base("servo6 sample")
    still = np.tile(log.q[:1], (len(log), 1))
    standing = replace(log, q=still, dq=np.zeros_like(still))
    assert gate(of, [standing]).refusal is None
    few = replace(log, **{name: getattr(log, name)[:10] for name in ("t", "t_host", "q", "dq", "tau", "current", "temperature",
                                                                      "q_cmd", "dq_cmd", "tau_cmd")})  # fmt: skip
    assert "too short" in (gate(of, [few]).refusal or "")


@pytest.mark.parametrize("seed", range(60))
def test_no_arrays_make_it_fail(seed: int) -> None:
    """Values of any size, NaN and infinities in any channel cause no exception, whether or not the recording is refused."""
    rng = np.random.default_rng(seed)
    of, log = base("servo6 sample")
    change = {}
    for name in ("t", "q", "dq", "tau", "current"):
        x = np.array(getattr(log, name), dtype=float)
        for _ in range(int(rng.integers(0, 3))):
            where = rng.random(x.shape) < rng.choice([1e-3, 0.1, 1.0])
            x = np.where(where, rng.choice([np.nan, np.inf, -np.inf, 0.0, 1e300, -1e-300, 1e6, 255.0]), x)
        if rng.random() < 0.3:
            x = rng.standard_normal(x.shape) * 10.0 ** rng.integers(-8, 8)
        change[name] = x
    found = gate(of, [replace(log, **change)], family=family)
    assert found.refusal is None or found.refusal


@pytest.fixture
def real_data() -> Path:
    import os

    folder = os.environ.get("ARM_CALIB_DATA")
    if not folder:
        pytest.skip("real recordings are not here: set ARM_CALIB_DATA to their folder")
    return Path(folder)


def test_every_real_recording_of_the_ur10e_passes(real_data: Path) -> None:
    files = [f for part in ("ur10e", "ur10e_more") for f in sorted((real_data / part).glob("*.csv")) if "broken" not in f.name]
    if not files:
        pytest.skip("no recordings of the UR10e in ARM_CALIB_DATA")
    of = arm("ur10e")
    for file in files:
        assert gate(of, [read_log(file, of.joint_names)], family=family).refusal is None, file.name
    together = gate(of, [read_log(file, of.joint_names) for file in files], family=family)
    assert together.refusal is None, together.refusal


def test_a_joint_may_turn_beyond_its_range_where_no_angle_matters() -> None:
    """A free shaft may turn on. An elbow that carries masses may not."""
    of, log = base("servo6 2")
    far = log.q + np.array([40.0, 0, 0, 0, 0, 0])  # the first axis is vertical
    assert gate(of, [replace(log, q=far)]).refusal is None
    bent = replace(log, q=log.q + np.array([0, 0, 40.0, 0, 0, 0]))
    assert "elbow_joint" in (gate(of, [bent]).refusal or "")


def test_by_how_much_a_residual_is_smaller_is_so_at_the_joint_that_is_named() -> None:
    """For a reversed load, the stated reduction is that of a fit of this joint alone."""
    of, log = base("ur5e 1")
    wrong, _ = changes(of)["load reversed, elbow_joint"](log, of, np.random.default_rng(0))
    refusal = str(gate(of, [wrong]).refusal)
    left = []
    for read in (wrong, log):
        s = signals([read], [read.tau])
        left.append(fitted(s, model_torque(of, s)).left[2])
    assert f"the residual of elbow_joint is {1 - left[1] / left[0]:.0%} smaller" in refusal


def spoilt(log: Log, channel: str, at: slice, joint: int | slice, value: float | np.ndarray) -> Log:
    x = np.array(getattr(log, channel))
    x[at, joint] = value
    return replace(log, **{channel: x})


def test_readings_that_no_drive_gives_are_named_as_such() -> None:
    """Spikes, an offset, a stopped feed and an unrecorded torque are not reported as a gear ratio or another column."""
    of, log = base("ur10e 3")
    half = slice(len(log) // 2, None)
    stopped = log
    for channel in ("q", "dq", "tau"):
        stopped = spoilt(stopped, channel, half, slice(None), getattr(log, channel)[len(log) // 2])
    for wrong, words in (
        (spoilt(log, "tau", slice(100, None, 97), 1, 9e4), "single readings of shoulder_lift_joint are damaged"),
        (spoilt(log, "tau", slice(None), 1, log.tau[:, 1] + 2000.0), "shoulder_lift_joint has an offset"),
        (stopped, "stopped being updated"),
        (spoilt(log, "tau", slice(None), slice(None), 0.0), "were not recorded"),
    ):
        found = gate(of, [wrong], family=family)
        assert found.refusal is not None
        assert words in found.causes[0].sentence


def test_readings_that_are_mostly_noise_are_no_other_clock() -> None:
    """A shift that moves a joint's motion out of the recording leaves a constant there, so the shift explains nothing."""
    from benchmarks.known_truth import recorded
    from calib.excitation.sweeps import friction_sweeps

    of, home = arm("ur5e"), np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
    motion = friction_sweeps(of, home, home - 0.8, home + 0.8, np.full((6, 2), (0.1, 0.4)), 1.5, 100.0)
    log = recorded(of, motion, 3)
    for seed in range(3):
        noise = np.random.default_rng(seed).normal(size=log.tau.shape) * of.tau_max
        found = gate(of, [replace(log, tau=log.tau + noise)], family=family)
        assert not any(c.kind == "shift" for cause in found.causes for c in cause.corrections), found.refusal


def test_samples_lost_under_an_even_clock_are_reported() -> None:
    of, log = base(BASES[0])
    kept = np.flatnonzero(np.arange(len(log)) % 52 < 50)
    part = replace(
        log,
        **{
            name: getattr(log, name)[kept]
            for name in ("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
        },
    )
    even = replace(part, t=log.t[: len(kept)], t_host=log.t_host[: len(kept)])
    details = [next(c.detail for c in gate(of, [x]).checks if c.check == "losses") for x in (log, even)]
    assert "the recorder lost samples and kept counting" in details[1]
    assert "kept counting" not in details[0]


def test_stamps_coarser_than_the_samples_are_no_wrong_unit() -> None:
    of, log = base("ur10e sample")
    found = gate(of, [replace(log, t=np.floor(log.t))])
    assert "the stamps are coarser than the samples" in (found.refusal or "")
    assert not any(cause.corrections for cause in found.causes)
    once = gate(of, [replace(log, t=np.zeros(len(log)))])
    assert "coarser" in (once.refusal or "")


def test_a_recording_without_torque_passes_and_says_what_was_not_checked() -> None:
    of, log = base("servo6 sample")
    nothing = np.full_like(log.tau, np.nan)
    found = gate(of, [replace(log, tau=nothing, current=nothing)])
    assert found.refusal is None
    assert "no torque or no masses" in next(check.detail for check in found.checks if check.check == "torque")
    one = nothing.copy()
    one[:, :-1] = log.tau[:, :-1]
    assert gate(of, [replace(log, tau=one, current=nothing)]).refusal is None
