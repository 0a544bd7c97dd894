"""A gear that twists under load."""

from __future__ import annotations

from sim.effects.effect import Effect, Parameter, PathState, Stage, Values


class JointElasticity(Effect):
    """q_motor = q + load/K."""

    name = "joint_elasticity"
    summary = "the gear twists"
    looks = "torque in proportion to the second derivative of the load; grows with frequency"
    reference = "M. W. Spong (1987), doi:10.1115/1.3143860"
    experiment = "a small motion from 1 to 15 Hz in two postures"
    stage = Stage.TRANSMISSION
    parameters = (Parameter("stiffness", "N*m/rad", "torque per twist", zero=None, lower=10.0, upper=1e7, start=1e4),)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """q_motor += load/K."""
        state.q_motor[:, joint] += state.load[:, joint] / p["stiffness"]
