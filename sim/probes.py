"""Points at which effects of the same form are tried before they are fitted: values between which the torque is linear."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Probe


def stiffnesses(effect: Effect) -> list[Probe]:
    """The torque is nearly linear in 1/stiffness: one probe for each stiffness of the grid, scaled."""
    stiffness = effect.parameter("stiffness")
    none = {"stiffness": stiffness.upper}

    def at(k: float) -> Probe:
        def combine(c: np.ndarray) -> dict[str, float]:
            return {"stiffness": k / max(float(c[0]), 1e-6)}

        return Probe(none, ({"stiffness": k},), combine)

    return [at(k) for k in stiffness.grid]


def waves(effect: Effect) -> list[Probe]:
    """A sin(N q + phase) is linear in A cos(phase) and A sin(phase): each N of the grid."""
    amplitude = 0.1 * effect.parameter("amplitude").grid[0]

    def at(cycles: float) -> Probe:
        def combine(c: np.ndarray) -> dict[str, float]:
            size, phase = float(np.hypot(c[0], c[1])), float(np.arctan2(c[1], c[0]))
            return {"amplitude": amplitude * size, "cycles": cycles, "phase": phase}

        points = tuple({"amplitude": amplitude, "cycles": cycles, "phase": p} for p in (0.0, 0.5 * np.pi))
        return Probe({"amplitude": 0.0, "cycles": cycles, "phase": 0.0}, points, combine)

    return [at(n) for n in effect.parameter("cycles").grid]
