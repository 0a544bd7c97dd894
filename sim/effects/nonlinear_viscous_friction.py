"""A friction law that is not proportional to speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from sim.effects.effect import Effect, Parameter, Values
from sim.interval import Interval
from sim.mjcf_form import Exported, JointSize
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

NEAR = 0.005
THINNEST = 1e-6  # rad/s, the smallest k of a shear-thinning fluid


class NonlinearViscousFriction(Effect):
    """tau = c |dq|^e sign(dq)."""

    name = "nonlinear_viscous_friction"
    summary = "viscous friction that is not proportional to speed"
    looks = "torque odd in speed that flattens (exponent below 1) or steepens (above 1) with speed"
    reference = "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit (1994), doi:10.1016/0005-1098(94)90209-7"
    experiment = "constant-speed sweeps at six or more speeds that span a factor of 30"
    stage = Stage.MOTOR
    surcharge = 11.0  # it can take almost any shape
    parameters = (
        Parameter("coefficient", "N*m*(s/rad)^exponent", "torque at 1 rad/s", grid=(1.0,)),
        Parameter("exponent", "1", "power of the speed", zero=None, lower=0.15, upper=3.5, grid=(0.3, 0.5, 0.7, 1.5, 2.0, 3.0)),
    )

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether it dissipates energy."""
        return p["coefficient"] > 0

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau += warmth c |dq|^e sign(dq)."""
        speed = state.dq_motor[:, joint]
        law = self.at(np.abs(speed), p["exponent"]) * np.sign(speed)
        state.tau[:, joint] += state.warmth[:, joint] * p["coefficient"] * law

    def at(self, speed: np.ndarray, exponent: float) -> np.ndarray:
        """Torque at a speed (N,) rad/s relative to that at 1 rad/s."""
        return speed**exponent

    def forms(self) -> Sequence[Effect]:
        """A shear-thinning fluid, or a polynomial."""
        return (_FluidOrPolynomial(),)

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """tau += warmth c |dq|^e sign(dq): monotone in dq and in e."""
        dq = box.dq[:, joints]
        ends = [np.abs(v) ** e * np.sign(v) for v in (dq.lo, dq.hi) for e in (p["exponent"].lo, p["exponent"].hi)]
        law = Interval(np.minimum(*ends[:2]), np.maximum(*ends[2:]))
        box.add(box.tau, joints, (box.warmth[:, joints] * p["coefficient"] * law).wider(unsure))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """Polynomial damping if it follows the power law within NEAR of the torque at full speed, else the callback."""
        x = np.linspace(0.0, 1.0, 201)
        powers = np.stack([x, x**2, x**3], axis=1)
        share = np.linalg.lstsq(powers, x ** p["exponent"], rcond=None)[0]
        off = float(np.abs(powers @ share - x ** p["exponent"]).max())
        if off > NEAR:
            return Exported("callback", "calib.mujoco")
        a, b, c = p["coefficient"] * size.speed ** p["exponent"] * share / size.speed ** np.arange(1, 4)
        words = f"{off:.1%} of its torque at {size.speed:.3g} rad/s, valid only up to that speed" if off > 1e-9 else ""
        return Exported("native", "damping polynomial", words, damping=(float(a), float(b), float(c)))


class _FluidOrPolynomial(NonlinearViscousFriction):
    """tau = c asinh(|dq|/k)/asinh(1/k) sign(dq) where e < 1, a lubricant that thins with shear; else c ((m+1-e) |dq|^m + (e-m) |dq|^(m+1)) sign(dq).

    m is the integer part of e. Both match the torque and the exponent of the power law at 1 rad/s. H. Eyring (1936), doi:10.1063/1.1749836.
    """

    def at(self, speed: np.ndarray, exponent: float) -> np.ndarray:
        """Torque relative to that at 1 rad/s."""
        if exponent < 1:
            k = float(brentq(lambda x: _slope(x) - max(exponent, _slope(THINNEST)), THINNEST, 1e3))
            return np.arcsinh(speed / k) / np.arcsinh(1 / k)
        m = np.floor(exponent)
        return (m + 1 - exponent) * speed**m + (exponent - m) * speed ** (m + 1)


def _slope(k: float) -> float:
    """d ln asinh(v/k) / d ln v at v = 1 rad/s."""
    x = 1 / k
    return float(x / (np.sqrt(1 + x * x) * np.arcsinh(x)))
