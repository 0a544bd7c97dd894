"""Torque that is periodic in the joint's position."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import ClassVar

import numpy as np

from sim.effects.effect import Effect, Parameter, Probe, Values
from sim.interval import sine
from sim.mjcf_form import Mjcf, passive
from sim.motion_view import CandidateColumns, MotionView
from sim.probes import waves
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage
from sim.turns import repeats

# Every gear meshes with forty or more teeth, whose weak ripple is in every log; ripple worth naming has fewer cycles.
CYCLES = np.arange(1, 25)


class TorqueRipple(Effect):
    """torque on the joint = A sin(N q + phase)."""

    name = "torque_ripple"
    summary = "torque periodic in position"
    looks = "a torque wave along the joint's angle, the same at every speed and in both directions"
    reference = "MuJoCo manual, actuator dcmotor, attribute cogging"
    experiment = "a slow full turn of that joint in both directions"
    many = True
    stage = Stage.JOINT
    surcharge = 10.0  # many cycles are tried
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("amplitude", "N*m", "peak torque", lower=0.0, grid=(0.5,)),
        Parameter(
            "cycles",
            "1/rev",
            "cycles in a revolution of the joint",
            zero=None,
            lower=0.5,
            upper=400.0,
            grid=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0),
            turns=True,
        ),
        Parameter("phase", "rad", "phase at the joint's zero", zero=None, lower=-2 * np.pi, upper=2 * np.pi),
    )

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Sine and cosine of every whole number of cycles along the joint's angle."""
        if joint is None or views[0].own(self.name, joint) is not None:
            return

        def samples(view: MotionView) -> np.ndarray:
            angle = view.link.q[:, joint, None] * CYCLES
            return view.rows(np.stack([-np.sin(angle), -np.cos(angle)], axis=2))

        def combine(c: np.ndarray, cycles: float) -> dict[str, float]:
            return {"amplitude": float(np.hypot(c[0], c[1])), "cycles": cycles, "phase": float(np.arctan2(c[1], c[0]))}

        waves = [v.kept((self.name, joint), partial(samples, v)) for v in views]
        for k, cycles in enumerate(CYCLES):
            yield CandidateColumns([{joint: wave[:, k]} for wave in waves], partial(combine, cycles=float(cycles)))

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether parts of the joint can cause a wave of that many cycles."""
        return repeats(p["cycles"])

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """load -= A sin(N q + phase)."""
        state.load[:, joint] -= p["amplitude"] * np.sin(p["cycles"] * state.q[:, joint] + p["phase"])

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """load -= A sin(N q + phase)."""
        wave = sine(p["cycles"] * box.q[:, joints] + p["phase"])
        box.add(box.load, joints, -(p["amplitude"] * wave).wider(unsure))
        box.steep[:, joints] += p["amplitude"].magnitude * (1 + unsure) * p["cycles"].magnitude * box.stretch[joints]

    def mjcf(self, joint: str, p: Values) -> Mjcf:
        """A passive dcmotor with cogging."""
        motor = passive(f"calib_{self.name}_{joint}", p["amplitude"], p["cycles"], p["phase"], joint=joint)
        return Mjcf(elements=(("actuator", "dcmotor", motor),))

    def probes(self, own: Values | None) -> list[Probe]:
        """Cosine and sine for each N of the grid; none if the arm already has the effect."""
        return waves(self) if own is None else []
