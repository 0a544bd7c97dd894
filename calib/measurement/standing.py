"""Pushes against a standing arm: its drives report a larger change of torque than dry friction can hide, and nothing moves.

The drive of a standing joint carries the load, give or take the dry friction F. Without an external torque, the reported torque
therefore stays within a band of width 2 F; F is all dry friction of the arm's model at this load
(sim.feedforward.dry_friction). A change of more than 2 F from the previous level while the joint stays in place is a push on
the arm, whatever the model of its inertias: S. Haddadin, A. De Luca, A. Albu-Schaffer (2017), doi:10.1109/TRO.2017.2723903,
section II.

A weight put on the flange does the same. A change that a weight explains counts as a push only if it is over within LIFTED.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.measurement.joint_torque import joint_torque
from logs.log import Log
from sim.arm import Arm
from sim.feedforward import dry_friction
from sim.rigid_body import RigidBody

GAP = 0.2  # s without a sample after which the state is discarded
MOVED = 0.01  # rad from where it came to rest, beyond which a joint counts as moving
SETTLING = 0.5  # s after a motion or a push in which a controller still changes its torque
LEVEL = 0.5  # s over which the level is averaged first
FOLLOWS = 2.0  # s, time constant with which the level then follows; integrators and warming are slower
CERTAIN = 0.15  # s that a torque must stay outside the band; an arm that starts to move has left its place by then
LIFTED = 5.0  # s: a longer change may be a load, which the next motion shows
CALM = 0.3  # s inside the band after which a push is over
HIDDEN = 1.25  # of 2 F: friction at rest exceeds friction in motion by this factor, and its fit is uncertain
UNSURE = 2.0  # standard deviations by which dry friction may exceed what the arm states
QUIET = 0.25  # of F: a push began when all torques were last this close to the level
NOISE = 6.0  # standard deviations of a sample's noise


@dataclass(frozen=True)
class Push:
    """A push: start and end (s; end NaN while it lasts), largest torque (n,) N m that drives added, and its doubt (n,) N m."""

    start: float
    end: float
    torque: np.ndarray
    doubt: np.ndarray

    @property
    def joint(self) -> int:
        """The joint that shows the push most clearly."""
        return int(np.argmax(np.abs(self.torque) / self.doubt))


class Standing:
    """Detector of pushes: `add` takes every sample of an arm and returns a push once it is certain, and again once it is over.

    A push that may be a weight is returned only once it is over. gravity (3,) m/s^2: the mounting, by default the arm's.
    """

    def __init__(self, arm: Arm, gravity: np.ndarray | None = None) -> None:
        if gravity is not None:
            arm = replace(arm, tree=replace(arm.tree, gravity=np.asarray(gravity, dtype=float)))
        self._arm = arm
        self._known = any(_states_friction(arm, joint) for joint in arm.joint_names)
        self._bodies = RigidBody(arm)
        self._up = -arm.tree.gravity
        self._rest: np.ndarray | None = None
        self._last = np.nan
        self._level = _Level(0.0, arm.n)
        self._push: Push | None = None
        self._weight = False

    def forget(self) -> None:
        """Discard the state: the next samples do not continue the previous ones."""
        self._rest = self._push = None

    def add(self, t: float, q: np.ndarray, tau: np.ndarray) -> Push | None:
        """Take one sample: t s, q (n,) rad, tau (n,) N m of the drives; return a push that is certain or over, else None."""
        if not self._known:
            return None
        if not t - self._last < GAP:
            self.forget()
        self._last = t
        if self._rest is None or not np.abs(q - self._rest).max() < MOVED:
            self._rest = q.copy()
            over = self._over(t, t)
            return None if self._weight else over
        level = self._level
        if t - level.since < SETTLING:
            return None
        if level.friction is None:
            level.friction = break_away(self._arm, q)
        off = tau - level.value
        noise = NOISE * np.sqrt(level.noise)
        band = HIDDEN * 2.0 * level.friction + noise
        if t - level.since < SETTLING + LEVEL or bool(np.all(np.abs(off) < band)):
            if self._push is not None:
                level.inside = t if np.isnan(level.inside) else level.inside
                return self._over(level.inside, t) if t - level.inside >= CALM else None
            if bool(np.all(np.abs(off) < QUIET * level.friction + noise)):
                level.quiet = t
            level.outside = np.nan
            level.peak = np.zeros_like(q)
            level.follow(t, tau)
            return None
        level.inside = np.nan
        level.outside = t if np.isnan(level.outside) else level.outside
        level.peak = np.where(np.abs(off) > np.abs(level.peak), off, level.peak)
        if self._push is None and t - level.outside >= CERTAIN:
            self._push = Push(level.quiet, np.nan, level.peak, band)
            self._weight = self._as_weight(q, level.peak, band)
            return None if self._weight else self._push
        return None

    def _over(self, end: float, t: float) -> Push | None:
        """The push that ended, None if there was none or if it was a weight for longer than LIFTED.

        The level starts anew at t, because friction may now hold the other way.
        """
        push, level = self._push, self._level
        self._push, self._level = None, _Level(t, self._arm.n)
        if push is None or (self._weight and end - push.start > LIFTED):
            return None
        return Push(push.start, end, level.peak, push.doubt)

    def _as_weight(self, q: np.ndarray, torque: np.ndarray, band: np.ndarray) -> bool:
        """Whether a weight at the flange could change every joint's torque by this much, within its band."""
        linear, _ = self._bodies.jacobian(q[None])
        per_kg = linear[0].T @ self._up
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(torque - band) / per_kg, (torque + band) / per_kg])
        lightest, heaviest = (np.nanmax(np.nanmin(ends, axis=0)), np.nanmin(np.nanmax(ends, axis=0)))
        return bool(max(lightest, 0.0) <= heaviest)


class _Level:
    """Torque level (n,) N m of an arm that stands since a time, and the noise variance of a sample."""

    def __init__(self, since: float, n: int) -> None:
        self.since = self.quiet = self._last = since
        self.value, self.noise, self.peak, self._before = np.zeros((4, n))
        self.outside = self.inside = np.nan  # since when the torque is outside, or inside again
        self.friction: np.ndarray | None = None
        self._count = 0

    def follow(self, t: float, tau: np.ndarray) -> None:
        """Update level and noise: a mean at first, then a low pass."""
        self._count += 1
        share = 1.0 / self._count
        if t - self.since > SETTLING + LEVEL:
            share = min((t - self._last) / FOLLOWS, 1.0)
        before, self._last, self._before = self._before, t, tau
        self.value = self.value + share * (tau - self.value)
        if self._count > 1:
            # from differences of neighbours, which neither slow drift nor the start of a push enlarges
            self.noise = (1.0 - share) * self.noise + share * 0.5 * (tau - before) ** 2


def pushes(arm: Arm, log: Log) -> list[Push]:
    """Every push against the standing arm in a log; one that lasts to a gap, or to the end of the log, ends there."""
    standing, found = Standing(arm), []
    tau = joint_torque(log, arm)
    good = np.isfinite(tau).all(axis=1) & np.isfinite(log.q).all(axis=1)
    latest: Push | None = None
    before = np.nan
    for k in np.flatnonzero(good):
        if latest is not None and log.t[k] - before >= GAP:  # what happened after the gap is no part of the push
            found.append(replace(latest, end=before))
            latest = None
        before = float(log.t[k])
        push = standing.add(float(log.t[k]), log.q[k], tau[k])
        if push is None:
            continue
        latest = push if np.isnan(push.end) else None
        if latest is None:
            found.append(push)
    if latest is not None:
        found.append(replace(latest, end=float(log.t[-1])))
    return found


def break_away(arm: Arm, q: np.ndarray) -> np.ndarray:
    """(n,) N m: largest dry friction at rest in a pose; infinite if the arm states none, as any torque may then be friction."""
    zero = np.zeros((1, arm.n))
    held = dry_friction(arm, RigidBody(arm).inverse_dynamics(q[None], zero, zero)[0])
    return np.array(
        [x + UNSURE * _std(arm, j) if _states_friction(arm, j) else np.inf for j, x in zip(arm.joint_names, held, strict=True)]
    )


def _std(arm: Arm, joint: str) -> float:
    dry = arm.effect("coulomb_friction", joint)
    return 0.0 if dry is None else dry.std.get("coulomb", 0.0)


def _states_friction(arm: Arm, joint: str) -> bool:
    dry = arm.effect("coulomb_friction", joint)
    return dry is not None and dry.parameters["coulomb"] > 0
