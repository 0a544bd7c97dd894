"""Forward simulation error: how far MuJoCo under the measured torque departs from a recording, over HORIZONS.

Windows start at the measured state. In open loop MuJoCo receives only the measured torque, and the angles at the end are
compared. Over the longest horizon an open loop diverges from any motion, whatever the model, so the loop is closed: a weak
spring and damper (LOOP) pull every joint to the measured motion, and the angles along the window are compared.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.measurement.preprocessing import Measurement
from sim.arm import Arm
from sim.flange import flange_of
from sim.model import no_warnings
from sim.own_values import value_of, values_of
from sim.plant import Plant
from sim.rigid_body import RigidBody

LOOP = 2 * np.pi * 1.0  # rad/s, natural frequency of the closed loop
DAMPING = 0.7
MEMORY = 1.0  # s
PARTS = 5
ON_AXIS = 1e-6  # m/rad, below which a joint does not move the flange
MOST_UNSEEN = 0.01  # share of a window: lost time that the stamps do not show


@dataclass(frozen=True)
class Horizon:
    """Duration, seconds; whether the loop is closed; most windows of a recording that are simulated."""

    seconds: float
    closed: bool
    windows: int

    @property
    def words(self) -> str:
        """Name in tables."""
        return f"{self.seconds:g} s, {'closed' if self.closed else 'open'} loop"

    def steps(self, m: Measurement) -> int:
        """Samples per window."""
        return max(1, round(self.seconds * m.rate))


SHORT = Horizon(0.25, False, 60)
HORIZONS = (SHORT, Horizon(1.0, False, 20), Horizon(5.0, True, 6))


@dataclass(frozen=True)
class ForwardError:
    """RMS over the windows of one horizon: angle error (n,) rad, flange error m, travel (n,) rad; NaN without windows.

    The errors are infinite if the simulation is unstable, as with friction that drives a light joint.

    starts: first sample of each window; squares: mean squared flange error, m^2, of each window, in closed loop of each of its
    PARTS parts. on_axis: the flange lies on the arm's axes, as with a bench drive; then squares are those of the angles, rad^2.
    """

    horizon: Horizon
    angle: np.ndarray
    flange: float
    travel: np.ndarray
    starts: tuple[int, ...]
    squares: np.ndarray
    on_axis: bool = False

    @property
    def compared(self) -> float:
        """RMS by which two arms are compared: flange error m, or angle error rad if the flange lies on the axes; NaN without windows."""
        return float(np.sqrt(self.squares.mean())) if len(self.squares) else float("nan")

    def entry(self) -> dict[str, Any]:
        """Entry of validation.json."""
        return {
            "horizon_s": self.horizon.seconds,
            "loop": "closed" if self.horizon.closed else "open",
            "windows": len(self.starts),
            "angle_rad": [_finite(x) for x in self.angle],
            "flange_m": _finite(self.flange),
            "travel_rad": [float(x) for x in self.travel],
        }


def forward_error(arm: Arm, m: Measurement, horizon: Horizon = SHORT, loop: Arm | None = None) -> ForwardError:
    """Forward simulation error of an arm on one recording.

    loop: arm whose inertia sets the gains of the closed loop, so that two arms are compared in the same loop. Windows begin
    where every joint moves: friction at rest holds any torque below its level, so a standing joint shows nothing.
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
                # all held for one period, so taken at its middle: the closed loop would otherwise follow half a period late
                q, dq, tau = (0.5 * (x[i] + x[i + 1]) for x in (tr.q, tr.dq, torque))
                plant.command(q, dq, tau, stiffness, damping)
                plant.advance(1 / m.rate)
                if horizon.closed or i == k + steps - 1:
                    errors.append(plant.encoder() - tr.q[i + 1])
                    at.append(i + 1)
            if not plant.stable:
                endless = np.full(arm.n, np.inf)
                return ForwardError(horizon, endless, np.inf, _rms(travel), tuple(starts), np.full(len(starts), np.inf))
    error = np.array(errors)
    linear, _ = bodies.jacobian(tr.q[at], point=flange_of(arm)[0])
    moved = np.einsum("kcj,kj->kc", linear, error)
    on_axis = bool(np.all(np.abs(linear) < ON_AXIS))
    parts = np.array_split(np.sum((error if on_axis else moved) ** 2, axis=1), len(starts) * (PARTS if horizon.closed else 1))
    squares = np.array([part.mean() for part in parts])
    flange = 0.0 if on_axis else float(np.sqrt(squares.mean()))
    return ForwardError(horizon, _rms(error), flange, _rms(travel), tuple(starts), squares, on_axis)


def measured_torque(arm: Arm, m: Measurement) -> np.ndarray:
    """(N, n) N m: joint torque behind the reading m.tau, with the arm's torque offset, gain and delay removed."""
    offset = values_of(arm, "torque_offset", "offset")
    gain = values_of(arm, "torque_gain", "gain", 1.0)
    late = value_of(arm, "time_delay", None, "delay")
    t = m.trajectory.t
    pairs = itertools.pairwise(m.starts)
    tau = np.concatenate([np.stack([np.interp(t[a:b] + late, t[a:b], x) for x in m.tau[a:b].T], axis=1) for a, b in pairs])
    return np.asarray((tau - offset) / gain)


def _turned(m: Measurement, k: int) -> int:
    """First sample of the history that still affects dry friction: MEMORY s before k, within the stretch."""
    return max(int(m.starts[np.searchsorted(m.starts, k, side="right") - 1]), k - round(MEMORY * m.rate))


def _finite(x: float) -> float | None:
    """The number, or None if JSON cannot hold it."""
    return float(x) if np.isfinite(x) else None


def _rms(x: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(x**2, axis=0)))


def _starts(m: Measurement, horizon: Horizon) -> list[int]:
    """First samples of the windows that are simulated."""
    return _spread(whole_windows(m, horizon), horizon.steps(m), horizon.windows)


def whole_windows(m: Measurement, horizon: Horizon) -> np.ndarray:
    """First samples of all windows without a gap; all joints move throughout a short one, at the start of a longer one."""
    steps = horizon.steps(m)
    moving = np.asarray(m.usable.all(axis=1))
    # a torque that was not read is stored as zero
    read = np.asarray(moving if horizon.seconds == SHORT.seconds else m.inside & (m.usable | (m.tau != 0.0)).all(axis=1))
    same = np.concatenate([np.diff(np.searchsorted(m.starts, np.arange(len(read)), side="right")) == 0, [False]])
    count = np.concatenate([[0], np.cumsum(read & same)])
    first = np.arange(max(len(read) - steps, 0))
    whole = (count[first + steps] - count[first] == steps) & read[first + steps]
    if m.unseen is not None:
        whole &= m.unseen[first + steps] - m.unseen[first] <= MOST_UNSEEN * horizon.seconds
    return np.flatnonzero(whole & moving[first])


def _spread(starts: Sequence[int] | np.ndarray, apart: int, most: int) -> list[int]:
    """At most `most` of the starts, spread over all of them, each at least `apart` samples from the one before."""
    chosen: list[int] = []
    for k in starts:
        if not chosen or k - chosen[-1] >= apart:
            chosen.append(int(k))
    if len(chosen) > most:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, most).astype(int)]
    return chosen
