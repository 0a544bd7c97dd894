"""How far the simulated arm moves from a recording: MuJoCo under the measured torque, over HORIZONS.

Windows start at the measured state. In the open loop MuJoCo gets the measured torque and nothing else, and the angles at the end are
compared. Over the longest horizon an open loop falls away from any motion, whatever the model; there the loop is closed: a weak spring
and damper (LOOP) pull every joint to the measured motion, and the angles along the window are compared.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.measurement.preprocessing import Measurement
from sim.arm import Arm
from sim.model import no_warnings
from sim.own_values import value_of, values_of
from sim.plant import Plant
from sim.rigid_body import RigidBody

LOOP = 2 * np.pi * 1.0  # rad/s, natural frequency of the closed loop
DAMPING = 0.7
MEMORY = 1.0  # s
PARTS = 5
MOST_UNSEEN = 0.01  # of a window: time that was lost although the stamps do not show it


@dataclass(frozen=True)
class Horizon:
    """seconds; whether the loop is closed; the most windows of a recording that are simulated."""

    seconds: float
    closed: bool
    windows: int

    @property
    def words(self) -> str:
        """As tables name it."""
        return f"{self.seconds:g} s, {'closed' if self.closed else 'open'} loop"

    def steps(self, m: Measurement) -> int:
        """Samples of a window."""
        return max(1, round(self.seconds * m.rate))


SHORT = Horizon(0.25, False, 60)
HORIZONS = (SHORT, Horizon(1.0, False, 20), Horizon(5.0, True, 6))


@dataclass(frozen=True)
class ForwardError:
    """Over all windows of one horizon: RMS angle error (n,) rad and flange error m, and RMS travel (n,) rad; NaN without any window.

    Infinite where the simulation is unstable, as it is with friction that drives a light joint.

    starts: first samples of the windows; squares: the flange's mean squared error in each, m^2, in a closed loop
    in each of PARTS of it.
    """

    horizon: Horizon
    angle: np.ndarray
    flange: float
    travel: np.ndarray
    starts: tuple[int, ...]
    squares: np.ndarray

    def entry(self) -> dict[str, Any]:
        """As validation.json has it."""
        return {
            "horizon_s": self.horizon.seconds,
            "loop": "closed" if self.horizon.closed else "open",
            "windows": len(self.starts),
            "angle_rad": [_finite(x) for x in self.angle],
            "flange_m": _finite(self.flange),
            "travel_rad": [float(x) for x in self.travel],
        }


def forward_error(arm: Arm, m: Measurement, horizon: Horizon = SHORT, loop: Arm | None = None) -> ForwardError:
    """The error of an arm on one recording; loop: the arm whose inertia sets the closed loop, so that two arms are compared in one loop.

    Windows begin where every joint moves: friction at rest holds any torque below its level, so a standing joint proves nothing.
    """
    steps, starts = horizon.steps(m), _starts(m, horizon)
    none = np.full(arm.n, np.nan)
    if not starts:
        return ForwardError(horizon, none, float("nan"), none, (), np.zeros(0))
    plant, bodies, tr = Plant(arm), RigidBody(loop or arm), m.trajectory
    rotor = values_of(loop or arm, "rotor_inertia", "inertia")
    torque, travel = measured_torque(arm, m), np.array([tr.q[k + steps] - tr.q[k] for k in starts])
    errors, at = [], []
    with no_warnings():
        for k in starts:
            stiffness = LOOP**2 * (np.diag(bodies.mass_matrix(tr.q[k])) + rotor) * horizon.closed
            damping = 2 * DAMPING / LOOP * stiffness
            warming = None if m.warming is None else m.warming[k]
            plant.reset(tr.q[k], tr.dq[k], tr.q[_turned(m, k) : k], float(tr.t[k] - tr.t[0]), warming)
            for i in range(k, k + steps):
                # the torque of the middle of the step stands for the step
                tau = 0.5 * (torque[i] + torque[i + 1])
                plant.command(tr.q[i], tr.dq[i], tau, stiffness, damping)
                plant.advance(1 / m.rate)
                if horizon.closed or i == k + steps - 1:
                    errors.append(plant.encoder() - tr.q[i + 1])
                    at.append(i + 1)
            if not plant.stable:
                endless = np.full(arm.n, np.inf)
                return ForwardError(horizon, endless, np.inf, _rms(travel), tuple(starts), np.full(len(starts), np.inf))
    error = np.array(errors)
    linear, _ = bodies.jacobian(tr.q[at])
    moved = np.einsum("kcj,kj->kc", linear, error)
    parts = np.array_split(np.sum(moved**2, axis=1), len(starts) * (PARTS if horizon.closed else 1))
    squares = np.array([part.mean() for part in parts])
    return ForwardError(horizon, _rms(error), float(np.sqrt(squares.mean())), _rms(travel), tuple(starts), squares)


def measured_torque(arm: Arm, m: Measurement) -> np.ndarray:
    """(N, n) N m that the arm says was there when the sensor read m.tau: without its offset, gain and delay."""
    offset = values_of(arm, "torque_offset", "offset")
    gain = values_of(arm, "torque_gain", "gain", 1.0)
    late = value_of(arm, "time_delay", None, "delay")
    t = m.trajectory.t
    pairs = itertools.pairwise(m.starts)
    tau = np.concatenate([np.stack([np.interp(t[a:b] + late, t[a:b], x) for x in m.tau[a:b].T], axis=1) for a, b in pairs])
    return np.asarray((tau - offset) / gain)


def _turned(m: Measurement, k: int) -> int:
    """The sample from which dry friction has forgotten what was before: MEMORY s earlier, not beyond the stretch."""
    return max(int(m.starts[np.searchsorted(m.starts, k, side="right") - 1]), k - round(MEMORY * m.rate))


def _finite(x: float) -> float | None:
    """A number that JSON can hold."""
    return float(x) if np.isfinite(x) else None


def _rms(x: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(x**2, axis=0)))


def _starts(m: Measurement, horizon: Horizon) -> list[int]:
    """First samples of the windows that are simulated."""
    return _spread(whole_windows(m, horizon), horizon.steps(m), horizon.windows)


def whole_windows(m: Measurement, horizon: Horizon) -> np.ndarray:
    """First samples of all windows of readings without a gap; over a short one every joint moves all the time, over a longer one at its start."""
    steps = horizon.steps(m)
    moving = np.asarray(m.usable.all(axis=1))
    # a torque that was not read is held as zero
    read = np.asarray(moving if horizon.seconds == SHORT.seconds else m.inside & (m.usable | (m.tau != 0.0)).all(axis=1))
    same = np.concatenate([np.diff(np.searchsorted(m.starts, np.arange(len(read)), side="right")) == 0, [False]])
    count = np.concatenate([[0], np.cumsum(read & same)])
    first = np.arange(max(len(read) - steps, 0))
    whole = (count[first + steps] - count[first] == steps) & read[first + steps]
    if m.unseen is not None:
        whole &= m.unseen[first + steps] - m.unseen[first] <= MOST_UNSEEN * horizon.seconds
    return np.flatnonzero(whole & moving[first])


def _spread(starts: Sequence[int] | np.ndarray, apart: int, most: int) -> list[int]:
    """At most `most` of the starts, each at least `apart` from the one before, spread over all of them."""
    chosen: list[int] = []
    for k in starts:
        if not chosen or k - chosen[-1] >= apart:
            chosen.append(int(k))
    if len(chosen) > most:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, most).astype(int)]
    return chosen
