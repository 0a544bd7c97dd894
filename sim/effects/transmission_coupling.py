"""A joint whose motor drives it through another joint, as in the wrists of small industrial arms.

The motor of joint j turns at w = dq_j + ratio dq_k, with k the joint right before j in the chain; the first joint has no such
motor. Its torque T on j acts as ratio T on k (virtual work). Each joint also has reflected inertia and friction of its own. T
counts as torque through the gears of both.

TX40, joints 5 and 6: ratio 1 and the parameters Ia_m6, Fv_m6, Fc_m6 (Gautier et al.); checked against computeFrictionModel.m of
BIRDy (Q. Leboutet et al. 2021, doi:10.3390/app11094303), where dry friction follows the speed of each joint instead of their sum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.mjcf_form import SOFT_FRICTION, Exported, JointSize, Mjcf
from sim.motion_view import CandidateColumns, MotionView
from sim.slip import SLIP_WIDTH, slip_along
from sim.slip_bounds import one_slip, way_in_one_direction
from sim.torque_box import CREEP, Known, TorqueBox
from sim.torque_path import PathState, Stage

# A motor that the previous joint turns by less than this share, or by more than its inverse, belongs to one joint alone.
LEAST_RATIO = 0.2
# rad/s^2 by which friction at 1 rad/s could accelerate the motor's inertia. On the exam (benchmarks/exam) it is above 7 where the effect was hidden, and
# 0.2 to 2.1 where it was wrongly named.
LEAST_FRICTION = 3.0
# share of the whole torque up to which a part may come out negative; it is then set to zero
NOISE = 0.2


class TransmissionCoupling(Effect):
    """T = I dw/dt + F_v w + F_c slip(w) on joint j, ratio T on the joint k right before it; w = dq_j + ratio dq_k."""

    name = "transmission_coupling"
    summary = "a joint is driven through another one"
    looks = "torque on two neighbouring joints that follows the sum of their speeds and accelerations"
    reference = "M. Gautier, A. Janot, P. O. Vandanjon (2013), doi:10.1109/TCST.2012.2185697"
    experiment = "each of the two joints moved alone, then both together"
    stage = Stage.FORCE
    driven = True
    parameters = (
        Parameter("ratio", "1", "motor turns per turn of the previous joint", zero=None, lower=-10.0, upper=10.0, grid=(1.0, -1.0)),
        Parameter("inertia", "kg*m^2", "motor inertia, as seen at the driven joint", lower=0.0, grid=(0.1,)),
        Parameter("viscous", "N*m*s/rad", "torque per summed speed", lower=0.0, grid=(1.0,)),
        Parameter("coulomb", "N*m", "level of dry friction of the summed motion", lower=0.0, grid=(1.0,)),
    )  # fmt: skip

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Linear in inertia, viscous and coulomb, for motors that turn either way; slightly negative parts are set to zero."""
        if not joint:
            return
        own = views[0].own(self.name, joint)
        for ratio in self.parameter("ratio").grid if own is None else (own["ratio"],):

            def rows(view: MotionView, ratio: float = ratio) -> np.ndarray:
                return view.rows(np.stack(_parts(view.link, joint, ratio), axis=1))

            found = [v.kept((self.name, joint, ratio), partial(rows, v)) for v in views]
            size = np.sqrt(sum(np.sum(x**2, axis=0) for x in found))
            columns = [{joint: x, joint - 1: ratio * x} for x in found]
            yield CandidateColumns(columns, partial(_combined, ratio=ratio, own=own, size=size))

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether the motor turns with both joints and has friction; with parallel axes, inertia alone is the error of a link."""
        rubs = p["coulomb"] + p["viscous"] * 1.0 > LEAST_FRICTION * p["inertia"]
        return rubs and LEAST_RATIO < abs(p["ratio"]) < 1 / LEAST_RATIO

    def passed_on(self, p: Values) -> float:
        """Virtual work: T on the joint, ratio T on the one before."""
        return p["ratio"]

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """load += T on the joint, ratio T on the one before."""
        before = self.joint_before(joint)
        parts = np.stack(_parts(state, before + 1, p["ratio"]), axis=1)
        torque = parts @ np.array([p["inertia"], p["viscous"], p["coulomb"]])
        state.load[:, joint] += torque
        state.load[:, before] += p["ratio"] * torque

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """load += T, ratio T; the summed motion has covered v^2 / (2 a) in one direction, from its speed and largest acceleration."""
        before, ratio = np.array([self.joint_before(int(j)) for j in joints], dtype=int), p["ratio"]
        speed = box.dq[:, joints] + ratio * box.dq[:, before]
        push = box.ddq[:, joints] + ratio * box.ddq[:, before]
        fastest = box.ddq_max[joints] + ratio.magnitude * box.ddq_max[before]
        slip = one_slip(*way_in_one_direction(speed, CREEP * (1 + ratio.magnitude), fastest), SLIP_WIDTH)
        torque = (p["inertia"] * push + p["viscous"] * speed + p["coulomb"] * slip).wider(unsure)
        box.add(box.load, joints, torque)
        box.add(box.load, before, (ratio * torque).wider(unsure))

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """armature, damping and frictionloss of a fixed tendon over both joints."""
        own = {"armature": repr(p["inertia"]), "damping": repr(p["viscous"]), "frictionloss": repr(p["coulomb"])}
        return Mjcf(tendon=(p["ratio"], {"name": f"calib_{self.name}_{joint}", **own, **SOFT_FRICTION}))

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """The tendon, which acts between motor and gear where a gear is soft."""
        return Exported("native", "fixed tendon", "dry friction is viscous below about 1 mrad/s", self.mjcf(joint, p))


def _parts(path: PathState, joint: int, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N,) each: acceleration, speed and slip of the summed motion; for a single instant the slip is the sign of the speed."""
    q, speed, push = (x[:, joint] + ratio * x[:, joint - 1] for x in (path.q, path.dq, path.ddq))
    slip = slip_along(path.t, q, speed, np.full(len(q), SLIP_WIDTH), 0.0) if len(q) > 1 else np.sign(speed)
    return push, speed, slip


def _combined(c: np.ndarray, ratio: float, own: Values | None, size: np.ndarray) -> dict[str, float]:
    """Coefficients of the three parts -> parameters; size (3,): norms of their columns."""
    names, whole = ("inertia", "viscous", "coulomb"), NOISE * float(np.linalg.norm(c * size))
    values = dict.fromkeys(names, 0.0) if own is None else own
    out = {"ratio": ratio}
    for name, x, s in zip(names, c, size, strict=True):
        value = values[name] + float(x)
        out[name] = 0.0 if value < 0 and abs(x) * s < whole else value
    return out
