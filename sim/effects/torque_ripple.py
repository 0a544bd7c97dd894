"""Torque that is periodic in the joint's position."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Mjcf, Parameter, PathState, Stage, Values


class TorqueRipple(Effect):
    """torque on the joint = A sin(N q + phase)."""

    name = "torque_ripple"
    summary = "torque periodic in position"
    looks = "a wave of torque along the joint's angle, the same at every speed and in both directions"
    reference = "MuJoCo manual, actuator dcmotor, attribute cogging"
    experiment = "a slow full turn of that joint in both directions"
    stage = Stage.JOINT
    parameters = (
        Parameter("amplitude", "N*m", "peak torque", lower=0.0, start=0.5),
        Parameter("cycles", "1/rev", "cycles in a revolution of the joint", zero=None, lower=0.5, upper=400.0, start=2.0),
        Parameter("phase", "rad", "phase at the joint's zero", zero=None, lower=-2 * np.pi, upper=2 * np.pi),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """load -= A sin(N q + phase)."""
        state.load[:, joint] -= p["amplitude"] * np.sin(p["cycles"] * state.q[:, joint] + p["phase"])

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """A passive dcmotor with cogging."""
        cogging = f"{p['amplitude']!r} {p['cycles']!r} {p['phase']!r}"
        motor = {"name": f"calib_torque_ripple_{joint}", "joint": joint, "input": "none", "resistance": "1", "motorconst": "0"}
        return Mjcf(elements=(("actuator", "dcmotor", motor | {"cogging": cogging}),))
