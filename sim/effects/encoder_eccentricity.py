"""A position reading with an error periodic in position."""

from __future__ import annotations

import numpy as np

from sim.effects.effect import Effect, Parameter, Probe, Unbounded, Values
from sim.interval import Interval
from sim.probes import waves
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage
from sim.turns import repeats

TURNS = (1, 2, 3, 4)  # cycles of drag per turn; a gear mounted off centre has one


class EncoderEccentricity(Effect):
    """reading = angle + A sin(N angle + phase)."""

    name = "encoder_eccentricity"
    summary = "error of the position reading, periodic in position"
    looks = "gravity and inertia of a posture whose error varies periodically with the joint's angle; the speed ripples with it"
    reference = (
        "Synapticon SOMANET documentation 4.19 (2022), wide angle error: eccentricity once, ovality twice per revolution"
    )
    experiment = "a slow full turn of that joint"
    many = True
    stage = Stage.ENCODER
    surcharge = 6.0  # many cycles are tried
    parameters = (
        Parameter("amplitude", "rad", "peak error", lower=0.0, upper=0.3, grid=(0.01,)),
        Parameter(
            "cycles",
            "1/rev",
            "cycles in a revolution of the joint",
            zero=None,
            lower=0.5,
            upper=50.0,
            grid=(1.0, 2.0, 3.0),
            turns=True,
        ),
        Parameter("phase", "rad", "phase at the joint's zero", zero=None, lower=-2 * np.pi, upper=2 * np.pi),
    )

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether parts of the joint can cause a wave of that many cycles, and no reading belongs to two angles."""
        return repeats(p["cycles"]) and p["amplitude"] * p["cycles"] < 1

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """Solve angle + A sin(N angle + phase) = reading by fixed-point iteration; speed and acceleration by the chain rule."""
        a, n, phase = p["amplitude"], p["cycles"], p["phase"]
        reading = state.q[:, joint].copy()
        angle = reading.copy()
        for _ in range(20):
            angle = reading - a * np.sin(n * angle + phase)
        slope = 1.0 + a * n * np.cos(n * angle + phase)
        curve = -a * n**2 * np.sin(n * angle + phase)
        speed = state.dq[:, joint] / slope
        state.ddq[:, joint] = (state.ddq[:, joint] - curve * speed**2) / slope
        state.dq[:, joint] = speed
        state.q[:, joint] = angle

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """angle = reading -+ A; speed and acceleration from the largest slope A N and curvature A N^2 of the wave."""
        a = p["amplitude"].magnitude * (1 + unsure)
        slope = a * p["cycles"].magnitude
        if not (slope < 1).all():
            raise Unbounded(self.name)  # one reading belongs to several angles
        box.q[:, joints] = Interval.around(box.q[:, joints].middle, box.q[:, joints].half + a)
        least, most = np.broadcast_to(1 / (1 + slope), (1, len(joints))), np.broadcast_to(1 / (1 - slope), (1, len(joints)))
        speed = box.dq[:, joints] * Interval(least, most)
        curve = slope * p["cycles"].magnitude * speed.magnitude**2
        bent = Interval(box.ddq.lo[:, joints] - curve, box.ddq.hi[:, joints] + curve)
        box.dq[:, joints], box.ddq[:, joints] = speed, bent * Interval(least, most)
        box.stretch[joints] *= most[0]
        box.ddq_max[joints] = (box.ddq_max[joints] + curve.max(axis=0)) * most[0]

    def reading(self, angle: np.ndarray, p: Values) -> np.ndarray:
        """angle + A sin(N angle + phase)."""
        return angle + p["amplitude"] * np.sin(p["cycles"] * angle + p["phase"])

    def probes(self, own: Values | None) -> list[Probe]:
        """Cosine and sine for each N of the grid; none if the arm already has the effect."""
        return waves(self) if own is None else []

    def imitators(self, path: PathState, joint: int) -> dict[str, np.ndarray]:
        """Drag of a gear mounted off centre: dq sin(N q) and dq cos(N q) for N in TURNS."""
        q, dq = path.q[:, joint], path.dq[:, joint]
        waves = [wave(n * q) * dq for n in TURNS for wave in (np.sin, np.cos)]
        return {"drag that varies along the angle": np.stack(waves, axis=1)}
