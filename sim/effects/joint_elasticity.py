"""A gear that twists under load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.effects.effect import Effect, Parameter, Probe, Values
from sim.mjcf_form import Exported, JointSize
from sim.probes import stiffnesses
from sim.torque_path import PathState, Stage

LEAST_TWIST = 2e-3  # rad under the largest load
# rad, accepted above BEYOND_DOUBT; true twists of 0.24e-3 and 0.35e-3 gain 126 and 399 (benchmarks/exam, seeds 26112941 and 26112951)
SURE_TWIST = 0.1e-3
BEYOND_DOUBT = 80.0
HARDENING = 0.1


class JointElasticity(Effect):
    """q_motor = q + load/K."""

    name = "joint_elasticity"
    summary = "the gear twists under load"
    looks = "torque proportional to the second derivative of the load; it grows with frequency"
    reference = "M. W. Spong (1987), J. Dynamic Systems, Measurement, and Control 109(4), 310-319"
    experiment = "a small motion from 1 to 15 Hz in two postures"
    stage = Stage.TRANSMISSION
    surcharge = 30.0  # it resembles the residual that most models leave at reversals
    part_of = "backlash"  # the sides of a gap yield under load
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
        """Whether the gear twists by more than dry friction yields before it slides; strong evidence allows a smaller twist."""
        twist = load / p["stiffness"]
        return twist > LEAST_TWIST or (evidence > BEYOND_DOUBT and twist > SURE_TWIST)

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """q_motor += load/K."""
        state.q_motor[:, joint] += self.twist(state.load[:, joint], p["stiffness"])

    def twist(self, load: np.ndarray, stiffness: float) -> np.ndarray:
        """Twist (N,) rad under a load (N,) N m."""
        return load / stiffness

    def forms(self) -> Sequence[Effect]:
        """A gear that stiffens with load, as strain wave gears do (T. Tuttle, W. Seering 1996, doi:10.1109/70.499819)."""
        return (_Hardening(),)

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """A second hinge between motor and link with a spring, damped at 2 % of critical for the motor with the link held."""
        stiffness = p["stiffness"]
        damping = 0.04 * float(np.sqrt(stiffness * max(size.rotor, 1e-4)))
        return Exported("native", "second hinge, stiffness", twist={"stiffness": repr(stiffness), "damping": repr(damping)})

    def probes(self, own: Values | None) -> list[Probe]:
        """One for each stiffness of the grid, scaled by compliance; none if the arm already has the effect."""
        return stiffnesses(self) if own is None else []


class _Hardening(JointElasticity):
    """q_motor = q + x, load = K x (1 + h (K x/L)^2)/(1 + h), L the RMS of the load: K is the stiffness under that load.

    h = HARDENING: the slope is 1.3 times the slope at rest under that load, and 1.9 times under twice that load. A
    manufacturer's tables give 1.2 to 1.4 for moderate and 1.6 to 2 for high torque (Harmonic Drive LLC, Cup Type Component
    Sets CSF and CSG, tables 41 and 42: K2/K1 and K3/K1).
    """

    def twist(self, load: np.ndarray, stiffness: float) -> np.ndarray:
        """x of the cubic law, by Newton's method from x = load/K."""
        usual = max(float(np.sqrt(np.mean(load**2))), 1e-12)
        y = load / usual
        x = y.copy()
        for _ in range(8):
            x -= (x * (1 + HARDENING * x**2) / (1 + HARDENING) - y) * (1 + HARDENING) / (1 + 3 * HARDENING * x**2)
        return x * usual / stiffness
