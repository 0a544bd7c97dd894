"""Whether the readings are of another arm: one that explains their shape and size better than the named arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calib.gate import scale
from calib.gate.check import Cause
from calib.gate.fit import GravityFit, fitted, model_torque
from calib.gate.missing import mounting_torque
from calib.gate.signals import Signals
from sim.arm import Arm

OTHER_SHAPE, OTHER_GAIN = 0.15, 0.4  # nats by which another arm must fit better: in shape, and in shape and size
OTHER_LEFT, OTHER_SCALE = 0.1, 1.15  # residual share, or scale, from which another arm is looked for
SPREAD_OF_SCALE = 0.4


def other_arm(
    arm: Arm, s: Signals, fit: GravityFit, sizes: Sequence[Cause], family: Callable[[], Sequence[Arm]] | None
) -> Cause | None:
    """Another arm with as many joints that explains shape and size of the readings better than this one with its unit corrected, or None."""
    if family is None:
        return None
    log_scale = scale.scale_of(arm, s, fit).log_scale
    left = fit.left / np.where(fit.size > 0, fit.size, np.nan)
    if not np.isfinite(log_scale).any() or (
        np.nanmedian(left) < OTHER_LEFT and abs(float(np.nanmedian(log_scale))) < math.log(OTHER_SCALE)
    ):
        return None
    shape, size = _merit(fit, log_scale - (np.nanmedian(log_scale) if sizes else 0.0))
    shape = max(shape, _loaded(arm, s, fit, (), scaled=True)[0])
    shape, size = max((shape, size), _loaded(arm, s, fit, (), scaled=False), key=sum)
    mounted = sum(_loaded(arm, s, fit, ("tilt", "pull"), scaled=False))
    best: Cause | None = None
    for candidate in family():
        if candidate.n != arm.n or candidate.name == arm.name:
            continue
        as_other = fitted(s, model_torque(candidate, s))
        their_shape, their_size = _merit(as_other, scale.scale_of(candidate, s, as_other).log_scale)
        gain = their_shape + their_size - max(shape + size, mounted)
        if their_shape - shape > OTHER_SHAPE and gain > OTHER_GAIN and (best is None or gain > best.gain):
            best = Cause(f"it is a recording of {candidate.name}", gain)
    return best


def _loaded(arm: Arm, s: Signals, fit: GravityFit, beside: Sequence[str], scaled: bool) -> tuple[float, float]:
    """`_merit` of the arm with what `mounting_torque` finds mounted."""
    held = replace(s, load=s.load - mounting_torque(arm, s, fit, beside, scaled))
    loaded = fitted(held, model_torque(arm, held))
    return _merit(replace(loaded, size=fit.size), scale.scale_of(arm, held, loaded).log_scale)


def _merit(fit: GravityFit, log_scale: np.ndarray) -> tuple[float, float]:
    """How well shape and size of the readings are explained, in nats."""
    left = np.log(fit.left / fit.size)
    return -float(left[np.isfinite(left)].sum()), -float((log_scale[np.isfinite(log_scale)] ** 2).sum()) / (
        2 * SPREAD_OF_SCALE**2
    )
