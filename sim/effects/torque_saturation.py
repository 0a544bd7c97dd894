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

# A drive's limit shows where the model asks for more than is measured: tried from just under the largest torque requested.
LIMITS = tuple(0.97 * 0.94**k for k in range(14))


class TorqueSaturation(Effect):
    """|tau| <= limit."""

    name = "torque_saturation"
    summary = "torque clips"
    looks = "flat tops of the torque at one level while the model asks for more, and a joint that then falls behind"
    reference = "MuJoCo manual, actuator forcerange"
    experiment = "the same motion at half speed"
    many = True
    stage = Stage.DRIVE
    parameters = (Parameter("limit", "N*m", "largest torque", zero=None, lower=0.0, upper=1e5, grid=(100.0,)),)

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """The model's torque cut at fractions of its largest; a coefficient of 1 is a cut as the model has it."""
        if joint is None or views[0].own(self.name, joint) is not None:
            return
        most = max(float(np.quantile(np.abs(v.tau_hat[:, joint]), 0.999)) for v in views)

        def cut(view: MotionView, limit: float) -> np.ndarray:
            tau = view.tau_hat[:, joint]
            return view.rows((np.clip(tau, -limit, limit) - tau)[:, None])

        def combine(c: np.ndarray, limit: float) -> dict[str, float]:
            # Half a cut is no cut: coefficients far from 1 give a limit that is refused as unphysical.
            return {"limit": limit if 0.6 < float(c[0]) < 1.6 else float("nan")}

        for limit in (fraction * most for fraction in LIMITS):
            columns = [{joint: v.kept_of(joint, (self.name, limit), partial(cut, v, limit))} for v in views]
            if limit > 0 and any(np.any(c[joint]) for c in columns):
                yield CandidateColumns(columns, partial(combine, limit=limit))

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """tau held in [-limit, limit]."""
        state.tau[:, joint] = np.clip(state.tau[:, joint], -p["limit"], p["limit"])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """No motion may need more than the drive is limited to, or the joint falls behind."""
        box.limit[joints] = np.minimum(box.limit[joints], p["limit"].lo * (1 - unsure))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """The forcerange of the joint's motors."""
        return Exported("native", "forcerange", limit=p["limit"])
