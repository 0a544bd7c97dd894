"""Torque columns: the residual that a missing effect would cause along a recorded motion, filtered as in a fit."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from sim.effects.effect import Effect, Probe
    from sim.rigid_body import RigidBody
    from sim.torque_path import PathState
    from sim.tree import KinematicTree

Combine = Callable[[np.ndarray], dict[str, float]]


class MotionView(Protocol):
    """One recording with an arm's present parameters: the motion, the torque that they predict, and the filter of its rows.

    n joints; tree of the arm; link: the path up to the load on the gears; reading (N, n) rad of the encoders; regressor_rows
    (R, n, 10 n) of the links, filtered; tau_hat (N, n) N m; starts: first sample of every gap-free stretch, then the number of
    samples.
    """

    @property
    def n(self) -> int: ...
    @property
    def tree(self) -> KinematicTree: ...
    @property
    def bodies(self) -> RigidBody: ...
    @property
    def link(self) -> PathState: ...
    @property
    def reading(self) -> np.ndarray: ...
    @property
    def regressor_rows(self) -> np.ndarray: ...
    @property
    def tau_hat(self) -> np.ndarray: ...
    @property
    def starts(self) -> np.ndarray: ...

    def own(self, effect: str, joint: int | None) -> Mapping[str, float] | None:
        """The arm's parameters of an effect, or None if it does not have it."""

    def torque_with(self, j: int, effect: str, values: Mapping[str, float]) -> np.ndarray:
        """tau (N,) N m of joint j if it had an effect behind the load with these parameters."""

    def posture_slopes(self, j: int) -> list[np.ndarray]:
        """d tau / d q_j, d tau / d dq_j and d tau / d ddq_j, each (N, n)."""

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Filtered rows (R, ...) of samples (N, ...)."""

    def kept(self, key: Hashable, rows: Callable[[], np.ndarray]) -> np.ndarray:
        """Rows cached under this key for the same motion and load of all joints; computed if missing."""

    def kept_of(self, j: int, key: Hashable, rows: Callable[[], np.ndarray]) -> np.ndarray:
        """Rows cached under this key for the same torque of joint j; computed if missing."""


class JointColumns(Mapping[int, np.ndarray]):
    """Joint index -> (R, k), computed on access: a caller that knows a candidate's products does not need them."""

    def __init__(self, joints: Collection[int], of: Callable[[int], np.ndarray]) -> None:
        self._joints, self._of = joints, of

    def __getitem__(self, joint: int) -> np.ndarray:
        return self._of(joint)

    def __iter__(self) -> Iterator[int]:
        return iter(self._joints)

    def __len__(self) -> int:
        return len(self._joints)


@dataclass(frozen=True)
class CandidateColumns:
    """An effect tried at one place, from one start of its nonlinear parameters.

    columns  per recording {joint index: (R, k) N m per unit of coefficient}, or the same as `JointColumns`
    combine  coefficients (k,) -> parameter values
    spread   (k,) prior standard deviation of the coefficients, if some may not show in the data at all; None: free
    """

    columns: Sequence[Mapping[int, np.ndarray]]
    combine: Combine
    spread: tuple[float, ...] | None = None


def behind_the_load(effect: Effect, views: Sequence[MotionView], j: int) -> Iterator[CandidateColumns]:
    """Candidates by the torque of joint j, one for each of the effect's probes."""
    own = views[0].own(effect.name, j)
    for i, probe in enumerate(effect.probes(own)):
        if probe.points:
            yield CandidateColumns(
                [JointColumns((j,), partial(_behind, effect, view, i, probe)) for view in views], probe.combine
            )


def _behind(effect: Effect, view: MotionView, i: int, probe: Probe, j: int) -> np.ndarray:
    """(R, k) of joint j at the i-th probe of an effect."""

    def rows() -> np.ndarray:
        own, base = view.own(effect.name, j), view.tau_hat[:, j]
        # an effect that vanishes at the probe's base leaves the torque as it is
        if own is not None or dict(probe.base) != effect.none():
            base = view.torque_with(j, effect.name, probe.base)
        return view.rows(np.stack([view.torque_with(j, effect.name, p) - base for p in probe.points], axis=1))

    return view.kept_of(j, (effect.name, i), rows)


def of_the_reading(effect: Effect, views: Sequence[MotionView], j: int) -> Iterator[CandidateColumns]:
    """Candidates for errors of a position reading: change in the torque of all joints for a slightly wrong posture."""
    own = views[0].own(effect.name, j)
    drive = tuple(
        tuple(values.items()) for name in ("rotor_inertia", "viscous_friction") if (values := views[0].own(name, j)) is not None
    )
    for i, probe in enumerate(effect.probes(own)):

        def samples(view: MotionView, probe: Probe = probe) -> np.ndarray:
            slope, moved = view.posture_slopes(j), []
            for point in probe.points:
                reading = view.reading[:, j]
                error = effect.reading(reading, point) - effect.reading(reading, probe.base)
                speed = np.gradient(error, view.link.t)
                errors = (error, speed, np.gradient(speed, view.link.t))
                moved.append(-sum((d * e[:, None] for d, e in zip(slope, errors, strict=True)), np.zeros(view.tau_hat.shape)))
            return np.stack(moved, axis=2)

        key = (effect.name, j, i, drive, None if own is None else tuple(own.items()))
        yield CandidateColumns([of_all_joints(view, key, partial(samples, view)) for view in views], probe.combine)


def by_joint(view: MotionView, rows: Callable[[], np.ndarray]) -> JointColumns:
    """Columns per joint (R, k) from rows (R, n, k), which are computed once."""
    whole = cache(rows)
    return JointColumns(range(view.n), lambda j: whole()[:, j])


def of_all_joints(view: MotionView, key: Hashable, samples: Callable[[], np.ndarray]) -> JointColumns:
    """Rows (R, k) per joint from samples (N, n, k) that depend only on the link side and on what the key names."""
    return by_joint(view, lambda: view.kept(key, lambda: view.rows(samples())))


def force_rows(view: MotionView) -> np.ndarray:
    """(R, n, 3) N m for 1 N along each axis of the base at the last link's origin."""

    def rows() -> np.ndarray:
        linear, _ = view.bodies.jacobian(view.link.q)
        return view.rows(-np.swapaxes(linear, 1, 2))

    return view.kept("force", rows)
