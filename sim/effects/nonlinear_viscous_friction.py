"""A friction law that is not proportional to speed."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, PathState, Stage, Values


class NonlinearViscousFriction(Effect):
    """tau = c |dq|^e sign(dq)."""

    name = "nonlinear_viscous_friction"
    summary = "speed law that is not proportional"
    looks = "torque odd in speed that bends: flattens (exponent below 1) or steepens (above 1) with speed"
    reference = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit (1994), doi:10.1016/0005-1098(94)90209-7"
    experiment = "constant-speed sweeps at six or more speeds over a range of 30"
    stage = Stage.MOTOR
    parameters = (
        Parameter("coefficient", "N*m*(s/rad)^exponent", "torque at 1 rad/s", grid=(1.0,)),
        Parameter("exponent", "1", "power of the speed", zero=None, lower=0.15, upper=3.5, grid=(0.3, 0.5, 0.7, 1.5, 2.0, 3.0)),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau += warmth c |dq|^e sign(dq)."""
        speed = state.dq_motor[:, joint]
        law = np.abs(speed) ** p["exponent"] * np.sign(speed)
        state.tau[:, joint] += state.warmth[:, joint] * p["coefficient"] * law
