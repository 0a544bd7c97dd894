"""Each kind of false reading is found within its time bound; correct readings pass, even late, noisy and coarse ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety import lies
from safety import monitor_rules as rules
from safety.collision import Clearance
from safety.monitor import Monitor
from safety.rows import NONE, Of, Row
from safety.trip import Trip
from sim.arm import Arm
from sim.cell import Cell
from sim.joint_state import JointState
from tests.safety.conftest import HOME

RATE = 500.0
NOTHING = np.full(6, np.nan)


class Readings:
    """Only the rules that compare readings with each other."""

    def __init__(self, arm: Arm, cell: Cell, clearance: Clearance, first: JointState) -> None:
        self.monitor = Monitor(arm, cell, RATE, clearance, first)

    def check(self, state: JointState, tau_hat: np.ndarray | None, doubt: np.ndarray | None) -> Trip | None:
        r, x, out = self.monitor._row, self.monitor._number, self.monitor._out
        r[Row.Q], r[Row.DQ], r[Row.TAU], x[Of.T], x[Of.T_DEVICE] = state.q, state.dq, state.tau, state.t, state.t_device
        x[Of.EXPECTED] = tau_hat is not None
        if tau_hat is not None:
            r[Row.TAU_HAT], r[Row.DOUBT] = tau_hat, doubt
        span = self.monitor._span
        for rule, look in ((12, lambda: lies.turned(r, x, span, out)), (13, lambda: lies.frozen_torque(r, x, len(span), out)),
                           (14, lambda: lies.swing(r, x, out)), (15, lambda: lies.clock(r, x, out))):  # fmt: skip
            joint = look()
            if joint != NONE:
                return self.monitor._broken(rule, joint)
        return None


def stream(arm: Arm, seconds: float, seed: int = 0, lag: float = 0.0, speed: float = 0.3) -> list[JointState]:
    """Readings of sinusoidal joint motions with sensor noise; the speed is `lag` s late, the torque depends on the posture."""
    rng, out = np.random.default_rng(seed), []
    for k in range(round(seconds * RATE)):
        t = k / RATE
        w = 2 * np.pi * 0.4
        q = HOME + speed / w * (1 - np.cos(w * t))
        dq = np.full(6, speed * np.sin(w * max(t - lag, 0.0))) + rng.normal(0, 1e-3, 6)
        tau = 40 * np.sin(q) + rng.normal(0, np.array(arm.sensors.torque_noise))
        q = np.round(q / 1e-5) * 1e-5
        out.append(JointState(t + 1e-4 * rng.random(), t, q, dq, tau, NOTHING, NOTHING))
    return out


def found(arm: Arm, cell: Cell, clearance: Clearance, states: list[JointState]) -> tuple[str, float] | None:
    """Quantity and instant of the first trip."""
    watching = Readings(arm, cell, clearance, states[0])
    for state in states[1:]:
        trip = watching.check(state, 40 * np.sin(state.q), np.full(6, 1.0))
        if trip is not None:
            return trip.quantity, state.t_device
    return None


@pytest.mark.parametrize("lag", [0.0, 0.015])
@pytest.mark.parametrize("speed", [0.0, 0.05, 0.3, 1.0])
def test_honest_readings_pass(arm: Arm, cell: Cell, clearance: Clearance, lag: float, speed: float) -> None:
    assert found(arm, cell, clearance, stream(arm, 8.0, lag=lag, speed=speed)) is None


@pytest.mark.parametrize(("scale", "joint"), [(0.0, 0), (0.0, 5), (1.6, 2), (-1.0, 3)])
def test_a_speed_that_is_not_that_of_the_position_is_found(
    arm: Arm, cell: Cell, clearance: Clearance, scale: float, joint: int
) -> None:
    states = stream(arm, 3.0)
    begin = 200
    for k in range(begin, len(states)):
        dq = states[k].dq.copy()
        dq[joint] *= scale
        states[k] = replace(states[k], dq=dq)
    trip = found(arm, cell, clearance, states)
    assert trip is not None
    assert "reported speed" in trip[0]
    assert trip[1] <= begin / RATE + rules.SPAN + 0.35  # a wrong scale is noticed once the joint is fast enough


def test_a_frozen_torque_is_found(arm: Arm, cell: Cell, clearance: Clearance) -> None:
    states = stream(arm, 2.0)
    begin = 250
    for k in range(begin, len(states)):
        tau = states[k].tau.copy()
        tau[1] = states[begin].tau[1]
        states[k] = replace(states[k], tau=tau)
    trip = found(arm, cell, clearance, states)
    assert trip is not None
    assert "very same torque" in trip[0]
    assert trip[1] <= begin / RATE + 2 * rules.SPAN


def test_a_torque_that_does_not_follow_the_motion_is_found(arm: Arm, cell: Cell, clearance: Clearance) -> None:
    """The torque stays noisy but does not follow the motion."""
    rng = np.random.default_rng(0)
    states = [replace(s, tau=40 * np.sin(HOME) + rng.normal(0, 0.1, 6)) for s in stream(arm, 6.0, speed=1.2)]
    trip = found(arm, cell, clearance, states)
    assert trip is not None
    assert "swing of the torque" in trip[0]
    assert trip[1] <= 2 * rules.SWING + 0.1


@pytest.mark.parametrize(
    ("rate", "trips"), [pytest.param(1.0, False, marks=pytest.mark.slow), (1.0001, False), (1.002, True), (0.998, True)]
)
def test_a_device_clock_at_another_rate_is_found(arm: Arm, cell: Cell, clearance: Clearance, rate: float, trips: bool) -> None:
    states = [replace(s, t=s.t_device * rate + s.t - s.t_device) for s in stream(arm, 20.0 if not trips else 6.0)]
    trip = found(arm, cell, clearance, states)
    assert (trip is not None) == trips
    if trip:
        assert "clock" in trip[0]
        assert trip[1] <= 5.0


def test_a_late_computer_is_no_drifting_clock(arm: Arm, cell: Cell, clearance: Clearance) -> None:
    rng = np.random.default_rng(1)
    states = [replace(s, t=s.t + 0.02 * rng.random() ** 4) for s in stream(arm, 10.0)]
    assert found(arm, cell, clearance, states) is None


def test_what_spans_a_pause_is_not_compared(arm: Arm, cell: Cell, clearance: Clearance) -> None:
    states = stream(arm, 1.0)
    watching = Readings(arm, cell, clearance, states[0])
    for state in states[1:]:
        assert watching.check(state, None, None) is None
    watching.monitor.pause()
    for state in states[1:]:
        moved = replace(state, q=state.q + 1.0, t=state.t + 5.0, t_device=state.t_device + 5.0)
        assert watching.check(moved, None, None) is None
