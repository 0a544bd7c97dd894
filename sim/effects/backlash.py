"""A gear with a dead zone.

While the motor crosses the gap, the link coasts with load = 0 and the motor keeps following its command. Their distance grows
with constant jerk, hence the cubic law, until an impact ends the crossing. The link's motion thus shows when the gap is crossed.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Exported, JointSize
from sim.torque_path import PathState, Stage

LOADED, FREE = 0.3, 0.05  # of the RMS load: above LOADED one side of the gap carries the load, below FREE neither does
MEAN = 25e-3  # s over which the load is averaged, so that noise in a measured acceleration does not cross the gap
BLOW = 6e-3  # s from the mean load exceeding LOADED to the middle of the impact that caused it

LEAST_GAP = 2e-4  # rad


class Backlash(Effect):
    """q_motor = q + b x, x = sign(load) where the gear is loaded, x = s (1 - 2 u^3) while the motor crosses from side s, u = 0 ... 1."""

    name = "backlash"
    summary = "dead zone when the load changes sign"
    looks = "no load for a moment where the load changes sign, then an impact; the following error (command minus reading) jumps by the whole gap"
    reference = "M. Nordin, P.-O. Gutman (2002), doi:10.1016/S0005-1098(02)00047-X"
    experiment = "slow motion through postures where gravity's torque on that joint changes sign"
    stage = Stage.TRANSMISSION
    surcharge = 8.0  # it resembles the residual that most models leave at reversals
    parameters = (Parameter("half_gap", "rad", "half of the dead zone", lower=0.0, upper=0.1, grid=(0.002,)),)

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether the gap is wider than one that the presliding displacement of dry friction imitates."""
        return p["half_gap"] > LEAST_GAP

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """q_motor += b x(t)."""
        state.q_motor[:, joint] += p["half_gap"] * side(state.t, state.load[:, joint])

    def motor_lead(self, load: np.ndarray) -> np.ndarray | None:
        """sign(load) where the gear is loaded, NaN elsewhere."""
        return np.where(np.abs(load) > LOADED * np.sqrt(np.mean(load**2)), np.sign(load), np.nan)

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """A second hinge between motor and link, with stops half a gap to either side."""
        gap, damping = p["half_gap"], 0.2 * max(size.rotor, 1e-4)
        stop = {"limited": "true", "range": f"{-gap!r} {gap!r}", "solreflimit": "0.004 1", "solimplimit": "0.99 0.999 0.0001"}
        return Exported("native", "second hinge, range", "the stops yield by 3 %", twist=stop | {"damping": repr(damping)})


def side(t: np.ndarray, load: np.ndarray) -> np.ndarray:
    """x (N,) in [-1, 1]: position of the motor in its gap at t (N,) s, under load (N,) N m through the gear."""
    if len(t) > 1:
        load = uniform_filter1d(load, max(1, round(MEAN / float(np.median(np.diff(t))))))
    usual = float(np.sqrt(np.mean(load**2)))
    loaded = np.flatnonzero(np.abs(load) > LOADED * usual)
    if len(loaded) == 0:
        return np.zeros(len(load))
    sign = np.sign(load[loaded])
    # the side that last carried the load; before the first load, the side that will carry it
    x = sign[np.clip(np.searchsorted(loaded, np.arange(len(load)), side="right") - 1, 0, None)]
    for k in np.flatnonzero(sign[:-1] != sign[1:]):
        last, first = loaded[k], loaded[k + 1]
        free = np.flatnonzero(np.abs(load[last:first]) < FREE * usual)
        begin = last + (free[0] if len(free) else 0)
        end = min(int(np.searchsorted(t, t[first] + BLOW)), len(t) - 1)
        u = (t[begin : end + 1] - t[begin]) / max(t[end] - t[begin], 1e-9)
        x[begin : end + 1] = sign[k] * (1.0 - 2.0 * np.clip(u, 0.0, 1.0) ** 3)
    return x
