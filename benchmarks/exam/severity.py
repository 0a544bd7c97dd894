"""rho, the visibility of an effect: RMS that it adds to the residual, beyond parameter scatter, over the noise of one reading.

Severities 1, 2, 3 are targets of rho. The dose for a target is found on the arm, posture and motions of the case itself: by two
runs of the plant that differ only in the effect, or by the torque that it adds along a recorded motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.exam.dynamics import torque_along
from benchmarks.exam.hidden import Answer, Hidden
from benchmarks.exam.motions import SETTLE, Reference
from benchmarks.exam.recording import encoder, torque_reading
from benchmarks.exam.true_arm import AMBIENT, TrueArm, run

TARGET = {1: 0.45, 2: 1.0, 3: 2.4}
LEAST = 0.6  # share of the smallest target below which an effect counts as invisible
COARSE = 1e-3  # s, time step of the runs that only measure an effect's size
BAND = 12.0  # Hz
RATE = 50.0  # Hz, of the rows compared
INDEPENDENT = 5.0  # rows of coloured noise that carry as much information as one independent row
Motion = TypeVar("Motion")
DOWN = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Rows:
    """A motion as the encoders read it, q dq ddq (N, 6), and the nominal arm's noise-free torque residual (N, 6) along it."""

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    residual: np.ndarray


def rows(arm: TrueArm, reference: Reference) -> Rows:
    """A run of the arm, filtered to BAND and decimated to RATE."""
    happened = run(arm, reference, SETTLE, np.full(6, AMBIENT), COARSE)
    step = round(float(happened.t[1] - happened.t[0]), 9)  # a stiff gear has shorter ones
    thin = round(1 / (RATE * step))
    logged = happened.t >= 0
    t = happened.t[logged]
    low = butter(4, BAND, fs=1 / step, output="sos")
    q = sosfiltfilt(low, encoder(arm.joints, happened.q[logged]), axis=0)
    tau = sosfiltfilt(low, torque_reading(arm, happened, t, np.random.default_rng(0)), axis=0)[::thin]
    dq = np.gradient(q, step, axis=0)
    ddq = np.gradient(dq, step, axis=0)[::thin]
    q, dq = q[::thin], dq[::thin]
    own = arm.nominal_joints
    expected = torque_along(arm.nominal, DOWN, q, dq, ddq) + own["rotor"] * ddq + own["viscous"] * dq
    expected += own["coulomb"] * np.tanh(dq / 5e-3)
    return Rows(q, dq, ddq, tau - expected)


class Balance(Generic[Motion]):
    """Compares effects with the arm without them. `rows` gives the rows of an arm along one of the motions."""

    def __init__(self, clean: TrueArm, motions: Sequence[Motion], rows: Callable[[TrueArm, Motion], Rows]) -> None:
        self.clean, self.motions, self.rows = clean, motions, rows
        self.before = [rows(clean, m) for m in motions]
        self.columns = scatter_columns(clean, self.before)

    def rho(self, hidden: TrueArm) -> float:
        """Largest RMS over joints and motions while the joint moves, or 0.4 RMS of its strongest 3 % (touch, clipped peak)."""
        added = np.concatenate([self.rows(hidden, m).residual for m in self.motions])
        added -= np.concatenate([b.residual for b in self.before])
        left = (added - self._scatter(added)) / self.clean.sensors.noise
        edges = np.cumsum([len(b.q) for b in self.before])
        largest = 0.0
        for part, motion in zip(np.split(left, edges[:-1]), self.before, strict=True):
            moving = np.abs(motion.dq) > 0.02
            square = np.where(moving, part**2, 0.0).sum(axis=0) / np.maximum(moving.sum(axis=0), 25)
            strongest = np.sort(np.where(moving, part**2, 0.0), axis=0)[-max(25, len(part) * 3 // 100) :].mean(axis=0)
            largest = max(largest, float(np.sqrt(max(square.max(), 0.16 * strongest.max()))))
        return largest

    def _scatter(self, added: np.ndarray) -> np.ndarray:
        """Part of `added` (N, 6) that parameters within their usual scatter explain: ridge with that scatter as prior."""
        noise = self.clean.sensors.noise * np.sqrt(INDEPENDENT)
        design = (self.columns / noise).reshape(len(self.columns), -1)
        size = np.linalg.solve(design @ design.T + np.eye(len(design)), design @ (added / noise).ravel())
        return np.tensordot(size, self.columns, axes=1)

    def dose(self, effect: Hidden, joint: int, severity: int, form: int, seed: int, spread: float) -> tuple[float, float]:
        """(dose, rho) of the visibility that the severity asks for, times `spread`, at most the largest plausible dose.

        An effect with a ladder gets the dose of its step; a larger one only if that would not be visible at all.
        """
        most = effect.most(self.clean, joint)
        target = TARGET[severity] * spread
        dose = min(effect.ladder[severity - 1] * spread if effect.ladder else effect.first(self.clean, joint), most)
        seen = 0.0
        for _ in range(4):
            hidden = self.clean.copy()
            effect.put(hidden, joint, dose, form, np.random.default_rng(seed))
            seen = self.rho(hidden)
            enough = seen > LEAST * TARGET[1] if effect.ladder else 0.8 < seen / target < 1.25
            if enough or (dose == most and seen < target):
                break
            wanted = TARGET[1] if effect.ladder else target
            dose = min(dose * float(np.clip(wanted / max(seen, 1e-3), 0.1, 10.0)), most)
        return dose, seen


def hide(effect: Hidden, arm: TrueArm, joint: int, dose: float, form: int, seed: int) -> Answer:
    """Put an effect of the given dose into an arm; return the answer."""
    return effect.put(arm, joint, dose, form, np.random.default_rng(seed))


def scatter_columns(arm: TrueArm, motions: Sequence[Rows]) -> np.ndarray:
    """Torque (p, N, 6) N m of one std of each mass, centre, friction and reflected inertia, and of 0.5 ms of delay."""
    q, dq, ddq = (np.concatenate([getattr(m, k) for m in motions]) for k in ("q", "dq", "ddq"))
    base = torque_along(arm.nominal, DOWN, q, dq, ddq)
    rotation, position, axis, mass, com, inertia = arm.nominal
    own, columns = arm.nominal_joints, []
    for i in range(len(mass)):
        heavier = mass.copy()
        heavier[i] *= 1.01
        columns.append(torque_along((rotation, position, axis, heavier, com, inertia), DOWN, q, dq, ddq) - base)
        for a in range(3):
            moved = com.copy()
            moved[i, a] += 0.01 * np.linalg.norm(com[i])
            columns.append(torque_along((rotation, position, axis, mass, moved, inertia), DOWN, q, dq, ddq) - base)
    for j in range(len(mass)):
        for share, column in (
            (0.03, own["coulomb"][j] * np.tanh(dq[:, j] / 5e-3)),
            (0.03, own["viscous"][j] * dq[:, j]),
            (0.02, own["rotor"][j] * ddq[:, j]),
            (5e-4, np.gradient(base[:, j], 1 / RATE)),
        ):
            single = np.zeros_like(base)
            single[:, j] = share * column
            columns.append(single)
    return np.array(columns)
