"""Whether a fitted effect is one that there may be: physical, in the recording, and off the bounds of its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.model import LogModel
from calib.diagnosis.parameters import logarithmic, parameters_of
from sim.arm import ArmEffect
from sim.effects import effect_named

# Share of a contact's duration that the recording must hold before and after it.
EDGE = 0.05


def admissible(f: Fit) -> bool:
    """Whether no shape parameter (an exponent, a time) ran into its bound, and every effect is one that there is: what fits best beyond is
    something else."""
    return all(plausible(e, f.models, np.inf) and within_recording(e, f) for e in f.accepted) and all(
        f.accepted[i].effect == CONTACT
        or not logarithmic(p)
        or p.lower * 1.01 < f.accepted[i].parameters[p.name] < p.upper * 0.99
        for i, p in parameters_of(f.accepted)
    )


def within_recording(item: ArmEffect, f: Fit) -> bool:
    """Whether a contact lies within its recording: a force that was there before or after it has no beginning or end to be known by."""
    if item.effect != CONTACT or f.hypothesis.event_log is None:
        return True
    t = f.models[f.hypothesis.event_log].link.t
    start, duration = item.parameters["start"], item.parameters["duration"]
    return bool(t[0] < start - EDGE * duration and start + (1 + EDGE) * duration < t[-1])


def plausible(item: ArmEffect, models: Sequence[LogModel], gain: float) -> bool:
    """Whether an effect is one that there may be in the recordings of the models; what was observed is there."""
    if item.key in models[0].hypothesis.observed:
        return True
    arm = models[0].arm
    joints = range(arm.n) if item.joint is None else [arm.joint_index(item.joint)]
    load = max(float(np.max(m.side.largest_load[joints])) for m in models)
    effect = effect_named(item.effect)
    whole = any(e.effect == effect.part_of and e.joint == item.joint for e in models[0].hypothesis.accepted)
    return effect.plausible(item.parameters, load, 0.0 if whole else gain)
