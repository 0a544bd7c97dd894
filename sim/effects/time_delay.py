"""A torque channel that lags the motion channel."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Exported, JointSize
from sim.motion_view import CandidateColumns, JointColumns, MotionView
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

# s: a drive's reading is commonly up to 1 ms early or late, which the fit estimates as an ordinary parameter.
LEAST_DELAY = 1.5e-3
# s: several, since beyond a few milliseconds the change of the torque is not its slope times the delay
DELAYS = (1e-3, 5e-3, 10e-3, 20e-3)


class TimeDelay(Effect):
    """reading(t) = tau(t - d)."""

    name = "time_delay"
    summary = "torque channel lags the motion channel"
    looks = "a residual that follows the rate of change of the torque, on all joints alike"
    reference = "J. Swevers, W. Verdonck, J. De Schutter (2007), on synchronous measurement, doi:10.1109/MCS.2007.904659"
    experiment = "a motion with several frequencies from 1 to 7 Hz"
    stage = Stage.CHANNEL
    scope = "arm"
    parameters = (Parameter("delay", "s", "age of the torque reading", lower=-0.05, upper=0.05, grid=(0.002,)),)

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """The predicted torque delayed by each of DELAYS, minus the torque itself."""
        own = views[0].own(self.name, None)
        before = own["delay"] if own else 0.0

        def later(view: MotionView, late: float, j: int) -> np.ndarray:
            def rows() -> np.ndarray:
                t, tau = view.link.t, view.tau_hat[:, j]
                pairs = itertools.pairwise(view.starts)
                then = np.concatenate([np.interp(t[a:b] - late, t[a:b], tau[a:b]) for a, b in pairs])
                return view.rows((then - tau)[:, None])

            return view.kept_of(j, (self.name, late), rows)

        def combine(c: np.ndarray, late: float) -> dict[str, float]:
            return {"delay": before + late * float(c[0])}

        for late in DELAYS:
            columns = [JointColumns(range(v.n), partial(later, v, late)) for v in views]
            yield CandidateColumns(columns, partial(combine, late=late))

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether it exceeds LEAST_DELAY, the usual delay of a drive's reading."""
        return p["delay"] > LEAST_DELAY

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau(t) = tau(t - d), linear between samples."""
        if len(state.t) > 1:
            for j in range(state.tau.shape[1]):
                state.tau[:, j] = np.interp(state.t - p["delay"], state.t, state.tau[:, j])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """reading(t) = tau(t - d) at the ends and the middle of d; a single box has no past and stays as it is."""
        if box.t is None or len(box.t) < 2:
            return
        lo, hi = box.reading.lo.copy(), box.reading.hi.copy()
        delay = p["delay"].wider(unsure)
        times = [box.t - d for d in (delay.lo[0], delay.middle[0], delay.hi[0])]
        for j in range(lo.shape[1]):
            box.reading.lo[:, j] = np.min([np.interp(t, box.t, lo[:, j]) for t in times], axis=0)
            box.reading.hi[:, j] = np.max([np.interp(t, box.t, hi[:, j]) for t in times], axis=0)

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """Delay of the sensors that read the motors' torque; none if it is negative, which would need future samples."""
        if p["delay"] < 0:
            return Exported("sensor", "none", "would need future samples; shift the recording instead")
        return Exported("sensor", "actuatorfrc, delay", "accurate to one simulation step", delay=p["delay"])
