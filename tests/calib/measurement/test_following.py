"""Gaps that the following error shows: size and standard deviation, and recordings that show none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.motion import measured
from calib.measurement.following import LEAST_BLOCKS, jackknifed
from calib.measurement.observed import Observed, clear, together
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.effects import effect_named
from sim.rigid_body import RigidBody
from tests.calib.diagnosis.conftest import recording

GAP = 3e-4  # rad
PAN = ("backlash", "shoulder_pan_joint")


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("ur10e")


def commanded(arm: Arm, log: Log, gap: float, seed: int = 5, late_by: float = 0.0, load: np.ndarray | None = None) -> Log:
    """A drive of finite stiffness, 8 ms late, with correlated errors; the first joint's motor crosses a gap within 40 ms.

    late_by: s by which it crosses later. load: (N, n) N m through the gears, if not that of the arm alone.
    """
    rng = np.random.default_rng(seed)
    ddq = np.gradient(log.dq, log.t, axis=0)
    load = RigidBody(arm).inverse_dynamics(log.q, log.dq, ddq) if load is None else load
    late = 8e-3 * log.dq + log.tau / 2e5 + 4e-5 * np.tanh(log.dq / 0.01)
    noise = 2e-5 * np.stack([correlated(rng, len(log.t)) for _ in range(arm.n)], axis=1)
    lead = np.zeros(log.q.shape)
    samples = round(late_by / float(np.median(np.diff(log.t))))
    lead[:, 0] = gap * np.convolve(np.roll(np.sign(load[:, 0]), samples), np.full(5, 0.2), mode="same")
    return replace(log, q_cmd=log.q + late + noise + lead)


def correlated(rng: np.random.Generator, count: int) -> np.ndarray:
    out = np.zeros(count)
    for k, x in enumerate(rng.standard_normal(count)):
        out[k] = 0.95 * out[k - 1] + x
    return out


def test_the_deviation_is_that_of_repeated_measurements() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(0, 20, 0.02)
    x = np.column_stack([np.ones(len(t)), np.sign(np.sin(1.3 * t))])
    found = [jackknifed(x, x @ [0.3, 2.0] + correlated(rng, len(t)), t.astype(int)) for _ in range(60)]
    value, std = np.array([(o.value, o.std) for o in found if o is not None]).T
    assert len(value) == 60
    assert abs(value.mean() - 2.0) < 4 * value.std() / np.sqrt(60)
    assert 0.8 < std.mean() / value.std() < 2.0


def test_a_few_seconds_show_nothing() -> None:
    block = np.repeat(np.arange(LEAST_BLOCKS - 1), 50)
    x = np.column_stack([np.ones(len(block)), np.sign(np.sin(np.arange(len(block))))])
    assert jackknifed(x, x[:, 1].copy(), block) is None


def test_recordings_are_weighed_by_their_information_and_nothing_counts_that_is_not_clear() -> None:
    key = ("backlash", "elbow_joint")
    parts = [{key: Observed(1.0, 0.1)}, {key: Observed(2.0, 0.2)}, {}]
    both = together(parts)[key]
    assert both.value == pytest.approx(1.2)
    assert both.std == pytest.approx(1 / np.sqrt(125))
    assert clear(parts) == {key: both}
    assert clear([{key: Observed(0.2, 0.1)}]) == {}
    assert clear([{key: Observed(-2.0, 0.1)}]) == {}


def test_a_motor_leads_by_the_sign_of_the_load() -> None:
    lead = effect_named("backlash").motor_lead(np.array([-4.0, 0.01, 5.0]))
    assert lead is not None
    assert lead[[0, 2]].tolist() == [-1.0, 1.0]
    assert np.isnan(lead[1])
    assert effect_named("joint_elasticity").motor_lead(np.ones(3)) is None


def test_a_gap_shows_with_its_size_and_a_sound_drive_shows_none(arm: Arm) -> None:
    log = recording(arm, 3, seconds=40.0)
    seen = measured(commanded(arm, log, GAP), arm).followed[PAN]
    assert abs(seen.value - GAP) < max(4 * seen.std, 0.15 * GAP)
    assert seen.value > 5 * seen.std
    for seed in range(8):
        sound = measured(commanded(arm, log, 0.0, seed), arm).followed
        assert PAN in sound
        assert clear([sound]) == {}


def test_a_motor_that_crosses_late_shows_no_smaller_gap(arm: Arm) -> None:
    log = recording(arm, 3, seconds=40.0)
    at_once, late = (measured(commanded(arm, log, GAP, late_by=s), arm).followed[PAN].value for s in (0.0, 0.09))
    assert late == pytest.approx(at_once, rel=0.01)


def test_no_commands_or_commands_that_repeat_the_reading_show_nothing(arm: Arm) -> None:
    log = recording(arm, 3, seconds=16.0)
    assert not np.isfinite(log.q_cmd).any()
    assert measured(log, arm).followed == {}
    assert measured(replace(log, q_cmd=log.q.copy()), arm).followed == {}
    some = commanded(arm, log, GAP)
    some.q_cmd[: len(log.t) * 2 // 3] = np.nan
    assert measured(some, arm).followed == {}


def test_a_joint_that_stands_stops_nothing(arm: Arm) -> None:
    log = recording(arm, 3, seconds=16.0, only=1)
    standing = replace(log, q=np.where(np.arange(arm.n) == 1, log.q, log.q[0]), dq=np.where(np.arange(arm.n) == 1, log.dq, 0.0))
    followed = measured(replace(standing, q_cmd=standing.q + 1e-4), arm).followed
    assert all(np.isfinite([o.value, o.std]).all() for o in followed.values())
