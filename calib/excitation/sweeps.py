"""Point-to-point motions at chosen speeds, by Ruckig's jerk-limited profiles: sweeps, reversals, holds; and a small chirp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Result, Ruckig, RuckigError
from ruckig import Trajectory as RuckigPath

from sim.arm import Arm
from sim.errors import ConfigError
from sim.trajectory import Trajectory

# share of acceleration and jerk that a sweep uses, far below where the quintic between two samples could exceed the limits
GENTLE = 0.4
DWELL = 0.3
LOW, HIGH = 0.5, 7.0  # Hz of the small chirp


@dataclass(frozen=True)
class Waypoint:
    """Go to q (n,) rad with at most speed (n,) rad/s, then stand still for `hold` s."""

    q: np.ndarray
    speed: np.ndarray
    hold: float = DWELL


def through(arm: Arm, start: np.ndarray, stops: Sequence[Waypoint], rate: float, gentle: float = GENTLE) -> Trajectory:
    """Motion from rest at `start` (n,) through every stop, at rest at each, at `rate` Hz; all joints arrive together.

    gentle: share of acceleration and jerk that is used. ConfigError if Ruckig finds no profile, as a stop is then outside the
    limits.
    """
    q, dq, ddq = [np.asarray(start, dtype=float)[None]], [np.zeros((1, arm.n))], [np.zeros((1, arm.n))]
    here = np.asarray(start, dtype=float)
    for stop in stops:
        path = _leg(arm, here, stop, gentle)
        if path is not None:
            count = max(2, int(np.ceil(path.duration * rate)))
            states = [path.at_time(min((k + 1) / rate, path.duration)) for k in range(count)]
            rows = np.array([np.stack(s[:3]) for s in states])
            rows[-1, 0], rows[-1, 1:] = stop.q, 0.0
            for part, k in ((q, 0), (dq, 1), (ddq, 2)):
                part.append(rows[:, k])
        here = np.asarray(stop.q, dtype=float)
        still = max(2, round(stop.hold * rate))
        q.append(np.repeat(here[None], still, axis=0))
        dq.append(np.zeros((still, arm.n)))
        ddq.append(np.zeros((still, arm.n)))
    positions = np.concatenate(q)
    return Trajectory(np.arange(len(positions)) / rate, positions, np.concatenate(dq), np.concatenate(ddq))


def _leg(arm: Arm, here: np.ndarray, stop: Waypoint, gentle: float) -> RuckigPath | None:
    if np.allclose(here, stop.q, atol=1e-12):
        return None
    task = InputParameter(arm.n)
    task.current_position, task.target_position = list(here), list(stop.q)
    task.max_velocity = list(np.maximum(stop.speed, 1e-4))
    task.max_acceleration = list(gentle * arm.ddq_max)
    task.max_jerk = list(gentle * arm.jerk_max)
    path = RuckigPath(arm.n)
    try:
        result: object = Ruckig(arm.n).calculate(task, path)
    except RuckigError as error:
        result = error
    if result not in (Result.Working, Result.Finished):
        raise ConfigError(
            f"{arm.name}: no motion from {here.round(4).tolist()} to {np.round(stop.q, 4).tolist()} rad ({result})"
        )
    return path


def friction_sweeps(
    arm: Arm, home: np.ndarray, low: np.ndarray, high: np.ndarray, speeds: np.ndarray, cruise: float, rate: float,
    gentle: float = GENTLE,
) -> Trajectory:  # fmt: skip
    """Each joint in turn, about `cruise` s each way at every speed (n, m) rad/s, within [low, high]; others stand at home."""
    stops = []
    for j in range(arm.n):
        for speed in speeds[j]:
            reach = cruise * float(speed) + 2 * float(speed) ** 2 / (gentle * float(arm.ddq_max[j]))
            reach = min(float(high[j] - low[j]), reach)
            middle = float(np.clip(home[j], low[j] + reach / 2, high[j] - reach / 2))
            for end in (middle - reach / 2, middle + reach / 2, middle - reach / 2):
                q = home.copy()
                q[j] = end
                stops.append(Waypoint(q, _only(arm, j, float(speed))))
        stops.append(Waypoint(home, _only(arm, j, float(speeds[j].max()))))
    return through(arm, home, stops, rate, gentle)


def reversal_ladder(arm: Arm, home: np.ndarray, amplitudes: Sequence[float], rate: float) -> Trajectory:
    """Each joint in turn, slowly back and forth at every amplitude (rad), to show friction before and at a reversal."""
    stops = []
    for j in range(arm.n):
        for amplitude in amplitudes:
            for sign in (1.0, -1.0, 1.0, -1.0, 0.0):
                q = home.copy()
                q[j] += sign * amplitude
                stops.append(Waypoint(q, _only(arm, j, max(0.02, 2.0 * amplitude)), 0.1))
    return through(arm, home, stops, rate)


def static_holds(arm: Arm, home: np.ndarray, postures: Sequence[np.ndarray], approach: float, rate: float) -> Trajectory:
    """Postures held from both sides: the mean of the two holds is gravity, half their difference dry friction."""
    fast = 0.3 * arm.dq_max
    stops = []
    for posture in postures:
        for side in (-1.0, 1.0):
            stops.append(Waypoint(posture + side * approach, fast, 0.1))
            stops.append(Waypoint(posture, np.full(arm.n, 0.05), 1.0))
    stops.append(Waypoint(home, fast))
    return through(arm, home, stops, rate)


def overlay(
    arm: Arm, home: np.ndarray, amplitude: np.ndarray, seconds: float, rate: float, gentle: float = GENTLE
) -> Trajectory:  # fmt: skip
    """Small chirp of all joints, faded at the ends: LOW to HIGH Hz for the first, 7 % of that more for each further joint.

    Its speed is amplitude (n,) rad/s, or less if that would take more than `gentle` of the acceleration or jerk.
    """
    count = round(seconds * rate)
    t = np.arange(count + 1) / rate
    offsets = 1 + 0.07 * np.arange(arm.n)
    sweep = np.log(HIGH / LOW)
    phase = 2 * np.pi * LOW * seconds / sweep * (np.exp(t / seconds * sweep) - 1)[:, None] * offsets
    turn = 2 * np.pi * LOW * np.exp(t / seconds * sweep)[:, None] * offsets
    slowness = amplitude**-4.0 + (gentle * arm.ddq_max / turn) ** -4.0 + (gentle * arm.jerk_max / turn**2) ** -4.0
    q = home + slowness**-0.25 * _fade(t, seconds, 0.15 * seconds)[:, None] * np.sin(phase) / turn
    spline = _smooth_derivatives(t, q)
    return Trajectory(t, q, *spline)


def _smooth_derivatives(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from scipy.interpolate import make_interp_spline

    zero = np.zeros((2, q.shape[1]))
    rest = [(k + 1, row) for k, row in enumerate(zero)]
    spline = make_interp_spline(t, q, k=5, bc_type=(rest, rest))
    dq, ddq = spline.derivative(1)(t), spline.derivative(2)(t)
    for row in (0, -1):
        dq[row] = ddq[row] = 0.0
    return dq, ddq


def _fade(t: np.ndarray, seconds: float, ramp: float) -> np.ndarray:
    """0 to 1 to 0 with three continuous derivatives at the ends."""
    s = np.clip(np.minimum(t, seconds - t) / ramp, 0.0, 1.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def _only(arm: Arm, joint: int, speed: float) -> np.ndarray:
    out = 0.3 * arm.dq_max
    out[joint] = speed
    return out
