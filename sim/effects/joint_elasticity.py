"""A gear that twists under load."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Probe, Values
from sim.mjcf_form import Exported, JointSize
from sim.torque_path import PathState, Stage

LEAST_TWIST = 2e-3  # rad under the largest load
SURE_TWIST = 0.4e-3  # beyond doubt: below, the model's wrong form of dry friction looks alike
BEYOND_DOUBT = 80.0


class JointElasticity(Effect):
    """q_motor = q + load/K."""

    name = "joint_elasticity"
    summary = "the gear twists"
    looks = "torque in proportion to the second derivative of the load; grows with frequency"
    reference = "M. W. Spong (1987), J. Dynamic Systems, Measurement, and Control 109(4), 310-319"
    experiment = "a small motion from 1 to 15 Hz in two postures"
    stage = Stage.TRANSMISSION
    surcharge = 30.0  # it imitates what a model leaves at reversals
    parameters = (
        Parameter(
            "stiffness",
            "N*m/rad",
            "torque per twist",
            zero=None,
            lower=10.0,
            upper=1e7,
            grid=(100.0, 300.0, 1e3, 3e3, 1e4, 3e4, 1e5),
        ),
    )

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """The gear twists by more than dry friction gives before it slides; beyond doubt, a smaller twist is accepted."""
        twist = load / p["stiffness"]
        return twist > LEAST_TWIST or (evidence > BEYOND_DOUBT and twist > SURE_TWIST)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """q_motor += load/K."""
        state.q_motor[:, joint] += state.load[:, joint] / p["stiffness"]

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """A second hinge between motor and link with a spring, damped at 2 % of critical, rotor against a held link."""
        stiffness = p["stiffness"]
        damping = 0.04 * float(np.sqrt(stiffness * max(size.rotor, 1e-4)))
        return Exported("native", "second hinge, stiffness", twist={"stiffness": repr(stiffness), "damping": repr(damping)})

    def probes(self, own: Values | None) -> list[Probe]:
        """The torque is nearly linear in 1/stiffness: try a few and scale."""
        if own is not None:
            return []
        none = {"stiffness": self.parameter("stiffness").upper}

        def at(stiffness: float) -> Probe:
            def combine(c: np.ndarray) -> dict[str, float]:
                return {"stiffness": stiffness / max(float(c[0]), 1e-6)}

            return Probe(none, ({"stiffness": stiffness},), combine)

        return [at(k) for k in self.parameter("stiffness").grid]
