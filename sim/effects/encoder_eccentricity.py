"""A position reading with an error periodic in position."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, PathState, Stage, Values


class EncoderEccentricity(Effect):
    """reading = angle + A sin(N angle + phase)."""

    name = "encoder_eccentricity"
    summary = "position reading periodic in position"
    looks = "gravity and inertia as of a posture that is wrong by a wave along the joint's angle; speed ripples with it"
    reference = "J. M. Hollerbach, W. Khalil, M. Gautier, Springer Handbook of Robotics (2016), chapter 6"
    experiment = "a slow full turn of that joint"
    stage = Stage.ENCODER
    parameters = (
        Parameter("amplitude", "rad", "peak error", lower=0.0, upper=0.3, start=0.01),
        Parameter("cycles", "1/rev", "cycles in a revolution of the joint", zero=None, lower=0.5, upper=50.0, start=1.0),
        Parameter("phase", "rad", "phase at the joint's zero", zero=None, lower=-2 * np.pi, upper=2 * np.pi),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """Solve angle + A sin(N angle + phase) = reading by fixed point, with speed and acceleration by the chain rule."""
        a, n, phase = p["amplitude"], p["cycles"], p["phase"]
        reading = state.q[:, joint].copy()
        angle = reading.copy()
        for _ in range(20):
            angle = reading - a * np.sin(n * angle + phase)
        slope = 1.0 + a * n * np.cos(n * angle + phase)
        curve = -a * n**2 * np.sin(n * angle + phase)
        speed = state.dq[:, joint] / slope
        state.ddq[:, joint] = (state.ddq[:, joint] - curve * speed**2) / slope
        state.dq[:, joint] = speed
        state.q[:, joint] = angle

    def reading(self, angle: np.ndarray, p: Values) -> np.ndarray:
        """angle + A sin(N angle + phase)."""
        return angle + p["amplitude"] * np.sin(p["cycles"] * angle + p["phase"])
