"""Ripple from a gear's teeth: torque that repeats dozens to hundreds of times per turn of the joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim.effects.effect import Probe, Values
from sim.effects.torque_ripple import TorqueRipple
from sim.interval import Interval
from sim.motion_view import CandidateColumns, MotionView
from sim.torque_box import Known, TorqueBox

FEWEST = 30.0  # cycles per turn; ripple with fewer is torque_ripple


class GearRipple(TorqueRipple):
    """torque on the joint = A sin(N q + phase), N >= 30: of a gear that is in order, such as two cycles a turn of a harmonic drive's motor."""

    name = "gear_ripple"
    summary = "torque periodic with the gear's teeth"
    looks = "a fine torque wave along the joint's angle, visible only at low speed"
    reference = "F. H. Ghorbel et al. (2001), On the kinematic error in harmonic drive gears, J. Mechanical Design 123(1), 90"
    parameters = tuple(replace(p, lower=FEWEST) if p.name == "cycles" else p for p in TorqueRipple.parameters)

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """None: a fit includes it beside every effect, so it is not a candidate."""
        return iter(())

    def probes(self, own: Values | None) -> list[Probe]:
        """None: it is not a candidate."""
        return []

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """load -= A sin(N q + phase), anywhere between -A and A: a following error spans several cycles."""
        size = p["amplitude"].magnitude * (1 + unsure)
        box.add(box.load, joints, Interval(-size, size) + Interval.zeros(box.load.lo[:, joints].shape))
