"""A cable, hose or spring that pulls the joint towards a rest angle."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Probe, Values
from sim.mjcf_form import Mjcf
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

RELAXATION = 3.0  # s; cables and hoses creep over 1 to 10 s, and time constants within a factor of three look alike


class JointSpring(Effect):
    """torque on the joint = -k (q - q_0)."""

    name = "joint_spring"
    summary = "cable, hose or spring"
    looks = "torque proportional to the joint's angle, at every speed"
    reference = "MuJoCo manual, joint stiffness and springref"
    experiment = "a slow motion over the whole range of that joint"
    stage = Stage.JOINT
    parameters = (
        Parameter("stiffness", "N*m/rad", "torque per angle", lower=0.0, grid=(2.0,)),
        Parameter("rest_angle", "rad", "angle without torque", zero=None, lower=-4 * np.pi, upper=4 * np.pi),
    )

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """load += k (q - q_0)."""
        state.load[:, joint] += p["stiffness"] * (state.q[:, joint] - p["rest_angle"])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """load += k (q - q_0)."""
        box.add(box.load, joints, (p["stiffness"] * (box.q[:, joints] - p["rest_angle"])).wider(unsure))
        box.steep[:, joints] += p["stiffness"].magnitude * (1 + unsure) * box.stretch[joints]

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """stiffness and springref."""
        return Mjcf({"stiffness": repr(p["stiffness"]), "springref": repr(p["rest_angle"])})

    def probes(self, own: Values | None) -> list[Probe]:
        """k (q - q_0) is linear in k and k q_0."""
        base = {"stiffness": 0.0, "rest_angle": 0.0} if own is None else dict(own)
        k, shift = base["stiffness"], base["stiffness"] * base["rest_angle"]

        def combine(c: np.ndarray) -> dict[str, float]:
            stiffness = k + float(c[0] + c[1])
            rest = (shift + float(c[1])) / stiffness if stiffness != 0 else 0.0
            return {"stiffness": stiffness, "rest_angle": rest}

        one = {"stiffness": k + 1.0, "rest_angle": shift / (k + 1.0)}
        two = {"stiffness": k + 1.0, "rest_angle": (shift + 1.0) / (k + 1.0)}
        return [Probe(base, (one, two), combine)]

    def imitators(self, path: PathState, joint: int) -> dict[str, np.ndarray]:
        """A cable that creeps: torque proportional to q - c, where the cable has crept to c with c' = (q - c) / RELAXATION."""
        from scipy.signal import lfilter  # takes half a second to import, which every command would pay

        q = path.q[:, joint]
        decay = np.exp(-float(np.median(np.diff(path.t))) / RELAXATION)
        crept = lfilter([1 - decay], [1, -decay], q - q[0]) + q[0]
        return {"a pull that relaxes within seconds": (q - crept)[:, None]}
