"""A drive that cannot deliver more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import Exported, JointSize
from sim.motion_view import CandidateColumns, MotionView
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

# A drive's limit shows where the model needs more torque than is measured; tried downwards from just below its largest torque.
LIMITS = tuple(0.97 * 0.94**k for k in range(14))


class TorqueSaturation(Effect):
    """|tau| <= limit."""

    name = "torque_saturation"
    summary = "torque clips"
    looks = "torque clipped at one level where the model needs more, and a joint that then falls behind"
    reference = "MuJoCo manual, actuator forcerange"
    experiment = "the same motion at half speed"
    many = True
    stage = Stage.DRIVE
    parameters = (Parameter("limit", "N*m", "largest torque", zero=None, lower=0.0, upper=1e5, grid=(100.0,)),)

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Change of the model's torque by clipping at fractions of its maximum; a coefficient of 1 is exactly that clipping."""
        if joint is None or views[0].own(self.name, joint) is not None:
            return
        most = max(float(np.quantile(np.abs(v.tau_hat[:, joint]), 0.999)) for v in views)

        def cut(view: MotionView, limit: float) -> np.ndarray:
            tau = view.tau_hat[:, joint]
            return view.rows((np.clip(tau, -limit, limit) - tau)[:, None])

        def combine(c: np.ndarray, limit: float) -> dict[str, float]:
            # Clipping has no strength: coefficients far from 1 give NaN, which is rejected as unphysical.
            return {"limit": limit if 0.6 < float(c[0]) < 1.6 else float("nan")}

        for limit in (fraction * most for fraction in LIMITS):
            columns = [{joint: v.kept_of(joint, (self.name, limit), partial(cut, v, limit))} for v in views]
            if limit > 0 and any(np.any(c[joint]) for c in columns):
                yield CandidateColumns(columns, partial(combine, limit=limit))

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau clipped to [-limit, limit]."""
        state.tau[:, joint] = np.clip(state.tau[:, joint], -p["limit"], p["limit"])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """Lower the drive's limit: a joint falls behind in a motion that needs more torque."""
        box.limit[joints] = np.minimum(box.limit[joints], p["limit"].lo * (1 - unsure))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """The forcerange of the joint's motors."""
        return Exported("native", "forcerange", limit=p["limit"])
