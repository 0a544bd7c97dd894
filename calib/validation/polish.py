"""M(q) e'' + D e' + K e = r + sum_k theta_k dr/dtheta_k: error of a simulated arm, and friction and offsets that reduce it.

Identification by inverse dynamics minimises the torque error; a polish reduces the error of the motion. Along the measured
motion the error e of the simulated one obeys this equation to first order, with the residual r, D = dtau/d(dq) and K = dtau/dq.
Many short windows begin with e = e' = 0 (multiple shooting; H. G. Bock, 1983). The errors at their ends are linear in the
corrections theta of dry friction, viscous friction and torque offset, which a ridge regression finds. MuJoCo decides the
strength of the ridge, and whether the corrections are accepted: it simulates the whole arm on recordings that took no part in
the regression. Their error after the best of three ridges is slightly optimistic; use another recording for `calib validate`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.measurement.preprocessing import Measurement
from calib.validation.forward import HORIZONS, forward_error, measured_torque, whole_windows
from calib.validation.tracking import moved_by
from sim.arm import Arm
from sim.effects import effect_named
from sim.errors import BadLog, ConfigError
from sim.own_values import value_of, values_of
from sim.prediction import predict
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

HORIZON = HORIZONS[1]
POLISHED = {"coulomb_friction": "coulomb", "viscous_friction": "viscous", "torque_offset": "offset"}
# s between the starts of windows, or more so that there are about MOST at most
APART, MOST = 0.1, 1000
# rad and rad/s over which derivatives are taken: over less, dry friction near a reversal would be too steep
STEP, SPEED_STEP = 1e-3, 2e-2
# strength with which each correction is drawn towards zero, relative to the size of its own effect
RIDGES = (3.0, 1.0, 0.3)
# least share of the error that the corrections must remove
WORTH = 0.02

Key = tuple[str, str]


@dataclass(frozen=True)
class Polished:
    """Result of a polish.

    arm: with the corrections if they are accepted; theta (p,): corrections of `keys`; before and after (n,) rad: RMS angle
    error on the held-out recordings.
    """

    arm: Arm
    accepted: bool
    keys: tuple[Key, ...]
    theta: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        before, after = (1e3 * float(np.sqrt(np.mean(x**2))) for x in (self.before, self.after))
        left = f"leave {after:.1f} mrad" if np.isfinite(after) else "make the simulation unstable"
        what = f"Simulated for {HORIZON.seconds:g} s under the measured torque, the arm ends"
        if self.accepted:
            return f"{what} {after:.1f} mrad from the held-out recordings; before the corrections, {before:.1f} mrad"
        return (
            f"{what} {before:.1f} mrad from the held-out recordings; corrections of friction and offsets {left} and are refused"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "schema": "polish/1", "accepted": self.accepted, "outcome": self.sentence, "horizon_s": HORIZON.seconds,
            "before_rad": self.before.tolist(), "after_rad": [float(x) if np.isfinite(x) else None for x in self.after],
            "corrections": [
                {"effect": effect, "joint": joint, "parameter": POLISHED[effect], "change": float(change)}
                for (effect, joint), change in zip(self.keys, self.theta, strict=True)
            ],
        }  # fmt: skip


@dataclass(frozen=True)
class Shots:
    """Errors (W, n) rad at the ends of the windows of one recording, and their Jacobian (W, n, p) in the corrections."""

    errors: np.ndarray
    slopes: np.ndarray


def shots_of(arm: Arm, m: Measurement, keys: Sequence[Key]) -> Shots:
    """Errors and derivatives to first order along the measured motion."""
    starts = whole_windows(m, HORIZON)
    starts = starts[:: max(round(APART * m.rate), len(starts) // MOST, 1)]
    still, tr, eye = moved_by(arm), m.trajectory, np.eye(arm.n)

    def along(q: np.ndarray, dq: np.ndarray, other: Arm = still) -> np.ndarray:
        """(N, n) N m that an arm predicts, stretch by stretch."""
        parts = [Trajectory(tr.t[a:b], q[a:b], dq[a:b], tr.ddq[a:b]) for a, b in itertools.pairwise(m.starts)]
        return np.concatenate([predict(other, part) for part in parts])

    tau_hat = along(tr.q, tr.dq)
    rotor = values_of(arm, "rotor_inertia", "inertia")
    bodies = RigidBody(arm)
    mass = np.array([bodies.mass_matrix(q) for q in tr.q]) + np.diag(rotor)
    stiff = np.stack([(along(tr.q + STEP * e, tr.dq) - tau_hat) / STEP for e in eye], axis=-1)
    ahead, behind = (np.stack([along(tr.q, tr.dq + step * e) for e in eye], axis=-1) for step in (SPEED_STEP, -SPEED_STEP))
    force = np.zeros((*tr.q.shape, 1 + len(keys)))
    force[..., 0] = measured_torque(arm, m) - tau_hat
    for k, (effect, joint) in enumerate(keys, start=1):
        if effect == "torque_offset":  # as `measured_torque` subtracts it
            force[:, arm.joint_names.index(joint), k] = -1.0 / value_of(arm, "torque_gain", joint, "gain", 1.0)
        else:
            step = 0.01 * max(abs(value_of(arm, effect, joint, POLISHED[effect])), 1e-3)
            force[..., k] = (tau_hat - along(tr.q, tr.dq, with_corrections(still, [(effect, joint)], [step]))) / step
    ends = _ends(starts, HORIZON.steps(m), 1 / m.rate, mass, (ahead - behind) / (2 * SPEED_STEP), stiff, force)
    return Shots(ends[..., 0], ends[..., 1:])


def _ends(
    starts: np.ndarray, steps: int, dt: float, mass: np.ndarray, damping: np.ndarray, stiff: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """(W, n, 1 + p) rad: errors at the ends of the windows under each force (N, n, 1 + p).

    Implicit Euler, because dry friction makes the equation stiff.
    """
    left = np.linalg.inv(mass + dt * damping + dt**2 * stiff)
    e = np.zeros((len(starts), *force.shape[1:]))
    v = np.zeros_like(e)
    for k in (starts + i for i in range(steps)):
        v = left[k] @ (mass[k] @ v + dt * (0.5 * (force[k] + force[k + 1]) - stiff[k] @ e))
        e = e + dt * v
    return e


def polish(
    arm: Arm,
    recordings: Sequence[Measurement],
    held: Sequence[Measurement],
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> Polished:
    """Correct friction and offsets of an identified arm to follow the recordings, if it then follows the held-out ones.

    ConfigError if the arm has neither. BadLog if no window begins with every joint in motion, or the simulation is unstable.
    """
    keys = tuple((e, j) for e in POLISHED for j in arm.joint_names if arm.effect(e, j) is not None)
    if not keys:
        raise ConfigError(f"{arm.name} has no friction and no torque offset that could be corrected; run calib identify first")
    shots = []
    for i, m in enumerate(recordings):
        progress("shooting", i / len(recordings))
        shots.append(shots_of(arm, m, keys))
    before = _simulated(arm, held)
    if not sum(len(s.errors) for s in shots) or not np.isfinite(before).all():
        raise BadLog(
            f"{arm.name}: a polish needs {HORIZON.seconds:g} s in which every joint moves at first, in the recordings and in the held-out ones, "
            "and a stable simulation; record an excitation, or run calib validate on the arm first"
        )
    best, theta = np.full(arm.n, np.inf), np.zeros(len(keys))
    for k, ridge in enumerate(RIDGES):
        progress("simulating", k / len(RIDGES))
        trial = _solved(shots, ridge)
        after = _simulated(with_corrections(arm, keys, trial), held)
        if np.mean(after**2) < np.mean(best**2):
            best, theta = after, trial
    accepted = bool(np.sqrt(np.mean(best**2)) < (1 - WORTH) * np.sqrt(np.mean(before**2)))
    polished = with_corrections(arm, keys, theta)
    made = np.array([_own(polished, key) - _own(arm, key) for key in keys])
    return Polished(polished if accepted else arm, accepted, keys, made, before, best)


def _simulated(arm: Arm, held: Sequence[Measurement]) -> np.ndarray:
    """(n,) rad: RMS angle error over the windows of all recordings; NaN without windows, infinite if unstable."""
    found = [one for m in held if (one := forward_error(arm, m, HORIZON)).starts]
    if not found:
        return np.full(arm.n, np.nan)
    return np.asarray(np.sqrt(np.average([one.angle**2 for one in found], axis=0, weights=[len(one.starts) for one in found])))


def _solved(shots: Sequence[Shots], ridge: float) -> np.ndarray:
    """(p,) corrections by ridge regression, each column scaled by its RMS effect on the errors."""
    a = np.concatenate([s.slopes.reshape(-1, s.slopes.shape[2]) for s in shots])
    b = np.concatenate([s.errors.ravel() for s in shots])
    size = np.sqrt(np.mean(a**2, axis=0))
    size[size == 0] = np.inf
    x = a / size
    return np.asarray(-np.linalg.solve(x.T @ x + ridge * len(x) * np.eye(len(size)), x.T @ b) / size)


def _own(arm: Arm, key: Key) -> float:
    return value_of(arm, *key, POLISHED[key[0]])


def with_corrections(arm: Arm, keys: Sequence[Key], theta: Sequence[float] | np.ndarray) -> Arm:
    """The arm with corrections added, within the bounds of each parameter."""
    change = dict(zip(keys, theta, strict=True))
    effects = []
    for e in arm.effects:
        step = change.get((e.effect, e.joint or ""))
        if step is not None:
            parameter = next(p for p in effect_named(e.effect).parameters if p.name == POLISHED[e.effect])
            value = float(np.clip(e.parameters[parameter.name] + float(step), parameter.lower, parameter.upper))
            e = replace(e, parameters={**e.parameters, parameter.name: value})
        effects.append(e)
    return replace(arm, effects=tuple(effects))
