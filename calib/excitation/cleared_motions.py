"""Motions of a session, scaled down until safety.clear accepts them."""

from __future__ import annotations

import numpy as np

from calib.excitation.design import binding, fitted_to_room
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.room import Room
from calib.excitation.sweeps import reversal_ladder, static_holds
from safety.plan import Motion
from sim.errors import AnswerIsNo, SafetyStop
from sim.trajectory import Trajectory

SHARES = (1.0, 0.99, 0.97, 0.93, 0.88, 0.82, 0.7, 0.55, 0.4)


def cleared_fourier(motion: Fourier, room: Room, rate: float, periods: int = 1) -> tuple[Trajectory, Fourier]:
    """Return samples of `periods` periods and the scaled motion, of which safety.clear accepts one period.

    The amplitude shrinks through SHARES while it refuses; SafetyStop if it refuses the last of them.
    """
    for k, share in enumerate(SHARES):
        smaller = motion.scaled(share)
        try:
            room.clear(smaller.sampled(rate))
            return smaller.sampled(rate, periods), smaller
        except SafetyStop:
            if k == len(SHARES) - 1:
                raise
    raise AssertionError("SHARES is not empty")


def bring_up(room: Room, basis: Basis, home: np.ndarray, rate: float, rng: np.random.Generator) -> list[Motion]:
    """Motions for an arm's first movement, at half the amplitude that fits: the last joint alone, then one more each time."""
    motions = []
    for count in range(1, room.arm.n + 1):
        locked = np.arange(room.arm.n) < room.arm.n - count
        found = None
        for _ in range(20):
            trial = random_fourier(Basis(4, basis.period), home, rng)
            found = found or fitted_to_room(room, Fourier(trial.basis, home, np.where(locked[:, None], 0.0, trial.x)))
        if found is None:
            raise AnswerIsNo(f"{room.arm.name}: {binding(room, basis, home)}")
        motions.append(Motion(f"bring_up_{count}", "probe", found.scaled(0.5).sampled(rate)))
    return motions


def probes(room: Room, home: np.ndarray, excitation: Fourier, rate: float) -> list[tuple[str, Trajectory]]:
    arm = room.arm
    ladder = reversal_ladder(arm, home, (0.002, 0.005, 0.015, 0.04), rate)
    path = excitation.sampled(40 / excitation.basis.period)
    far = path.q[np.linspace(0, len(path) - 1, 7).astype(int)[1:-1]]
    holds = static_holds(arm, home, [home + 0.8 * (q - home) for q in far], 0.03, rate)
    half = Fourier(Basis(excitation.basis.harmonics, 2 * excitation.basis.period), home, excitation.x / 2)
    slow, _ = cleared_fourier(half, room, rate)
    out = [("reversals", ladder), ("half_speed", slow)]
    if room.use(thinned(holds, 60.0)).fits:
        try:
            room.clear(holds)
            out.append(("holds", holds))
        except SafetyStop:
            pass
    return out


def thinned(motion: Trajectory, rate: float) -> Trajectory:
    step = max(1, round((len(motion) - 1) / motion.duration / rate))
    return Trajectory(motion.t[::step], motion.q[::step], motion.dq[::step], motion.ddq[::step])
