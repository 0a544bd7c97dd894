"""Whether a fitted effect is admissible: physically plausible, inside its recording, and off the bounds of its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.model import LogModel
from calib.diagnosis.parameters import logarithmic, parameters_of
from sim.arm import ArmEffect
from sim.effects import effect_named

# Share of a contact's duration that the recording must extend beyond it at either end.
EDGE = 0.05


def admissible(f: Fit) -> bool:
    """Whether every effect is plausible and inside its recording, and no shape parameter (an exponent, a time) is at a bound.

    A best fit at a bound means that the cause is something else.
    """
    return all(plausible(e, f.models, np.inf) and within_recording(e, f) for e in f.accepted) and all(
        f.accepted[i].effect == CONTACT
        or not logarithmic(p)
        or p.lower * 1.01 < f.accepted[i].parameters[p.name] < p.upper * 0.99
        for i, p in parameters_of(f.accepted)
    )


def within_recording(item: ArmEffect, f: Fit) -> bool:
    """Whether a contact begins and ends inside its recording; otherwise neither its start nor its end can be determined."""
    if item.effect != CONTACT or f.hypothesis.event_log is None:
        return True
    t = f.models[f.hypothesis.event_log].link.t
    start, duration = item.parameters["start"], item.parameters["duration"]
    return bool(t[0] < start - EDGE * duration and start + (1 + EDGE) * duration < t[-1])


def plausible(item: ArmEffect, models: Sequence[LogModel], gain: float) -> bool:
    """Whether an effect is plausible in the recordings of the models; an effect that another channel shows always is."""
    if item.key in models[0].hypothesis.observed:
        return True
    arm = models[0].arm
    joints = range(arm.n) if item.joint is None else [arm.joint_index(item.joint)]
    load = max(float(np.max(m.side.largest_load[joints])) for m in models)
    effect = effect_named(item.effect)
    whole = any(e.effect == effect.part_of and e.joint == item.joint for e in models[0].hypothesis.accepted)
    return effect.plausible(item.parameters, load, 0.0 if whole else gain)
