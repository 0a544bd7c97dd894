"""All states of a motion, our stop or the device's stop lie in the boxes, at samples and between them."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.driver import DeviceStop
from safety.braking import stop_profile
from safety.device_stops import DeviceStops
from safety.limits import sampled
from safety.sheets import STAGES, Boxes, OwnStops, PathSheet
from sim.arm import Arm
from sim.errors import SafetyStop
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME, sine

ROUND = 1e-9


@pytest.fixture(scope="module")
def fast() -> Trajectory:
    motion = sine(amplitude=0.4, duration=3.0)
    return sampled(motion, np.arange(0, 1501) / 500)


def inside(boxes: Boxes, k: int, m: int, states: np.ndarray) -> bool:
    """Whether states (S, 3, n) lie in the box of one cell."""
    return bool(np.all(boxes.lo[k, m] - ROUND <= states) and np.all(states <= boxes.hi[k, m] + ROUND))


def test_the_motion_lies_in_its_boxes_between_samples_too(arm: Arm, fast: Trajectory) -> None:
    sheet = PathSheet(fast, arm)
    for k in range(0, len(fast) - 1, 11):
        t = np.linspace(fast.t[k], fast.t[k + 1], 9)
        part = sampled(sine(amplitude=0.4, duration=3.0), t)
        assert inside(sheet.boxes, k, 0, np.stack((part.q, part.dq, part.ddq), axis=1))
        parts = sheet.refined(k, 0)
        lo, hi = parts.lo[:, 0], parts.hi[:, 0]
        held = (lo[:, None] - ROUND <= part.q) & (part.q <= hi[:, None] + ROUND)
        assert held.all(axis=2).any(axis=0).all()
    assert sheet.time(7) == fast.t[7]


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_our_stops_lie_in_their_boxes_and_in_their_parts(arm: Arm, fast: Trajectory, share: float) -> None:
    stops = OwnStops(fast, arm, share * arm.ddq_max)
    for k in range(0, len(fast), 37):
        for m in range(STAGES):
            t = (m + np.linspace(0, 1, 25)) / STAGES * stops.duration[k]
            travel, dq, ddq = (x[0] for x in stops.profile.rows(slice(k, k + 1)).state(t[None, :, None]))
            q = fast.q[k] + travel
            assert inside(stops.boxes, k, m, np.stack((q, dq, ddq), axis=1))
            parts, states = stops.refined(k, m), np.stack((q, dq, ddq), axis=1)
            held = (parts.lo[:, None] - ROUND <= states) & (states <= parts.hi[:, None] + ROUND)
            assert held.all(axis=(2, 3)).any(axis=0).all()
    assert stops.time(3) == fast.t[3]


@pytest.mark.parametrize("proportional", [True, False])
@pytest.mark.parametrize("softest", [1.0, 0.5])
def test_device_stops_from_any_instant_and_by_any_allowed_deceleration_lie_in_their_boxes(
    arm: Arm, fast: Trajectory, proportional: bool, softest: float
) -> None:
    """An independent implementation: begin anywhere between two samples, coast, brake with any allowed deceleration."""
    device, latency = DeviceStop(0.02, 4.0, proportional), 0.01
    sheet = DeviceStops(fast, arm, device, latency, softest)
    motion, rng = sine(amplitude=0.4, duration=3.0), np.random.default_rng(0)
    coast = device.reaction + latency
    for k in range(0, len(fast) - 1, 97):
        parts = [sheet.refined(k, m) for m in range(STAGES)]
        for _ in range(4):
            begin = rng.uniform(fast.t[k], fast.t[k + 1])
            start = sampled(motion, np.array([begin, begin + 1e-9]))
            q, dq = start.q[0], start.dq[0]
            a = rng.uniform(softest, 1.0) * device.deceleration
            braking = np.abs(dq) / a
            if proportional:
                braking = np.full(arm.n, braking.max())
            for t in np.linspace(0, sheet.duration[k], 25):
                u = np.clip(t - coast, 0, braking)
                with np.errstate(divide="ignore", invalid="ignore"):
                    left = np.where(braking > 0, 1 - u / braking, 0.0)
                    way = min(t, coast) + np.where(braking > 0, u - u**2 / (2 * braking), 0.0)
                at = np.stack((q + dq * way, dq * (left if t > coast else 1.0)))
                lo, hi = sheet.boxes.lo[k, :, :2], sheet.boxes.hi[k, :, :2]
                assert ((lo - ROUND <= at) & (at <= hi + ROUND)).all(axis=(1, 2)).any()
                assert any(((p.lo[:, :2] - ROUND <= at) & (at <= p.hi[:, :2] + ROUND)).all(axis=(1, 2)).any() for p in parts)
            assert np.all(np.abs(q + dq * (coast + braking / 2) - q) <= sheet.end()[k] + ROUND)
    assert (sheet.softest is sheet) == (softest == 1.0)


def test_merged_boxes_hold_the_boxes_they_were_made_of(arm: Arm, fast: Trajectory) -> None:
    sheet = OwnStops(fast, arm, arm.ddq_max)
    assert sheet.levels[-1][2].lo.shape[:2] == (1, 1)
    for rows, stages, boxes in sheet.levels[1:]:
        for k in range(0, len(fast), 101):
            for m in range(STAGES):
                assert np.all(boxes.lo[k // rows, m // stages] <= sheet.boxes.lo[k, m])
                assert np.all(boxes.hi[k // rows, m // stages] >= sheet.boxes.hi[k, m])


@pytest.mark.parametrize(("bound", "value"), [("lo", np.nan), ("hi", np.nan), ("lo", -np.inf), ("hi", np.inf), ("lo", 2.0)])
def test_boxes_with_one_bound_that_is_none_are_not_finite(bound: str, value: float) -> None:
    boxes = Boxes(np.zeros((2, 2, 3, 6)), np.ones((2, 2, 3, 6)))
    assert boxes.finite()
    getattr(boxes, bound)[1, 0, 2, 4] = value
    assert not boxes.finite()


@pytest.mark.parametrize(("spare", "allowed"), [(2e-5, True), (-2e-5, False)])
def test_a_stop_that_would_pass_a_limit_is_refused(arm: Arm, spare: float, allowed: bool) -> None:
    """One joint moves towards its limit, which lies just beyond, or just before, the end of the stop."""
    arm = replace(arm, jerk_max=np.full(6, 1e-3))
    dq, ddq = np.full((2, 6), 1.5), np.zeros((2, 6))
    motion = Trajectory(np.array([0.0, 1e-3]), np.vstack((HOME, HOME + 0.0015)), dq, ddq)
    hard = replace(arm, jerk_max=np.full(6, 200.0))
    end = stop_profile(dq, ddq, hard.ddq_max, hard.jerk_max).extrema()[1] + motion.q
    for make, reached, message in (
        (lambda a: OwnStops(motion, replace(a, jerk_max=hard.jerk_max), a.ddq_max), end, "a stop that begins at t=0.0010 s"),
        (
            lambda a: DeviceStops(motion, a, DeviceStop(0.02, 4.0), 0.0),
            motion.q + dq * (0.02 + 1.5 / 8),
            "the device's own stop that begins at t=0.0000 s",
        ),
    ):
        tight = replace(arm, q_max=reached.max(axis=0) + np.array([2e-5, 2e-5, spare, 2e-5, 2e-5, 2e-5]))
        if allowed:
            make(tight).check_limits()
        else:
            with pytest.raises(SafetyStop, match=f"j3: {message}"):
                make(tight).check_limits()


@pytest.mark.parametrize(
    "made",
    [
        lambda motion, arm: OwnStops(motion, arm, arm.ddq_max),
        lambda motion, arm: DeviceStops(motion, arm, DeviceStop(0.02, 4.0), 0.0),
    ],
    ids=["own", "device"],
)
def test_what_nobody_holds_is_gone_without_a_collection(
    arm: Arm, fast: Trajectory, made: Callable[[Trajectory, Arm], OwnStops | DeviceStops]
) -> None:
    """Boxes of a long motion take megabytes, of a plan hundreds of megabytes; a control loop runs without the collector."""
    gc.disable()
    try:
        stops = made(fast, arm)
        assert stops.softest is stops
        gone = weakref.ref(stops)
        del stops
        assert gone() is None
    finally:
        gc.enable()
