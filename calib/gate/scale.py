"""Whether the torque (or current) has the right size: the scale of every joint's reading against the arm's masses, its limits and the other joints."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.gate.check import Cause
from calib.gate.correction import Correction
from calib.gate.fit import GravityFit
from calib.gate.readings import OVER_LOAD, SHARE
from calib.gate.signals import Signals
from sim.arm import Arm

# Share of a joint's reading that masses must cause for its scale to be estimated; they must also cause more than the residual.
INFORMATIVE = 0.12
SURE = 4.0  # standard deviations
ODD, ODD_ALONE, ODD_LOADED = (
    4.0,
    6.0,
    30.0,
)  # a scale beyond is no model error: of all joints alike, of one against the others, and of one where a load may be the cause
PATTERN = 2.2  # readings fit a unit within this
DRY_ODD = 12.0  # dry friction of one joint, as a share of tau_max, against that of the others
LEAST_LEFT = 0.6  # a fit with a larger share of residual does not determine a scale


@dataclass(frozen=True)
class Scale:
    """log_scale (n,) is ln a, with its std; NaN where a joint is not informative; impossible (n,): joints with readings that they cannot give."""

    log_scale: np.ndarray
    std: np.ndarray
    impossible: np.ndarray

    @property
    def informative(self) -> np.ndarray:
        """(n,) joints that are informative."""
        return np.isfinite(self.log_scale)


def scale_of(arm: Arm, s: Signals, fit: GravityFit) -> Scale:
    """The scale of every joint; loads in N m."""
    with np.errstate(invalid="ignore", divide="ignore"):
        shown = fit.signal > np.maximum(INFORMATIVE * fit.size, fit.left)
        good = shown & (fit.scale > SURE * fit.scale_std) & (fit.left < LEAST_LEFT * fit.size)
        log_scale = np.where(good, np.log(np.where(good, fit.scale, 1.0)), np.nan)
        std = np.where(good, fit.scale_std / np.where(good, fit.scale, 1.0), np.nan)
        limit = np.where(np.isfinite(arm.tau_max) & (arm.tau_max > 0), arm.tau_max, np.inf)
        size = np.abs(s.load) if len(s) else np.zeros((1, s.n))
        impossible = np.nan_to_num(np.quantile(size, 1 - SHARE, axis=0)) > OVER_LOAD * limit
    return Scale(log_scale, std, impossible)


def causes(arm: Arm, s: Signals, fit: GravityFit, from_current: np.ndarray, known_unit: bool) -> list[Cause]:
    """Likely causes of readings of the wrong size, best first; none where the size is right or cannot be estimated.

    from_current (n,): joints whose reading is a current; known_unit: whether all readings are in N m.
    """
    scale = scale_of(arm, s, fit)
    found: list[Cause] = []
    at = scale.log_scale[scale.informative]
    common = float(np.median(at)) if len(at) else math.nan
    if known_unit:
        found = _common(arm, scale, at, common, from_current)
    apart = 0.0 if not math.isfinite(common) else common
    if not found:
        found = _alone(arm, scale, apart if known_unit or len(at) > 2 else math.nan, fit)
    if not found and scale.impossible.any() and known_unit:
        found = _beyond(arm, s, scale, from_current)
    return found


def _common(arm: Arm, scale: Scale, at: np.ndarray, common: float, from_current: np.ndarray) -> list[Cause]:
    if not len(at) or abs(common) < math.log(ODD):
        return []
    constant = arm.torque_constant
    ways: list[tuple[float, Correction]] = []
    thousand = Correction("unit", "current", unit="mA") if from_current.all() else Correction("unit", "tau", unit="mNm")
    if not from_current.any() or from_current.all():
        ways.append((_off(at - math.log(1e3)), thousand))
    if constant is not None and not from_current.any():
        ways.append((_off(at + np.log(constant[scale.informative])), Correction("current", "tau")))
    named = [(off, way) for off, way in ways if off < math.log(PATTERN)]
    spread = float(np.std(at)) if len(at) > 1 else 0.0
    if not named and spread > math.log(PATTERN):
        return []  # no unit does that, a wrong model does
    low, high = _interval(scale)
    out = [
        Cause(way.sentence(arm.joint_names), abs(common) - off, (way,), (low, high))
        for off, way in sorted(named, key=lambda pair: pair[0])
    ]
    factor = Correction("scale", "tau", (), float(f"{math.exp(common):.4g}"))
    sentence = f"the torque (or current) is {low:.3g} to {high:.3g} times what the arm's masses require"
    if not from_current.any() and common < 0 and constant is None:
        sentence += f"; a current in A would fit a torque constant of {1 / high:.3g} to {1 / low:.3g} N m/A at the joint"
    least = min([abs(common) - spread, *(cause.gain - 0.01 for cause in out)])
    return [*out, Cause(sentence, least, (factor,), (low, high))]


def _interval(scale: Scale) -> tuple[float, float]:
    """95 % interval of the common scale; joints differ by more than each one's own uncertainty."""
    at, std = scale.log_scale[scale.informative], scale.std[scale.informative]
    error = math.hypot(float(np.std(at)) / math.sqrt(len(at)), float(np.min(std)))
    middle = float(np.median(at))
    return math.exp(middle - 2 * error), math.exp(middle + 2 * error)


def _alone(arm: Arm, scale: Scale, common: float, fit: GravityFit) -> list[Cause]:
    """One joint's reading against those of the others: by its masses, else by its dry friction."""
    out = []
    whole = fit.size / np.where(arm.tau_max > 0, arm.tau_max, np.nan)
    # dry friction below the residual has no size to compare, for example where a joint has none
    shown = (fit.dry > fit.left) & (fit.left < LEAST_LEFT * fit.size)
    share = np.where(shown & (arm.tau_max > 0), fit.dry / arm.tau_max, np.nan)
    for j, name in enumerate(arm.joint_names):
        others = np.delete(np.arange(arm.n), j)
        if scale.informative[j] and math.isfinite(common):
            rest = scale.log_scale[others]
            rest = rest[np.isfinite(rest)]
            off = scale.log_scale[j] - (float(np.median(rest)) if len(rest) else 0.0)
            odd = abs(off) > math.log(ODD_ALONE) and (len(rest) > 0 or abs(off) > 2 * math.log(ODD_ALONE))
            odd &= _dry_too(share, j, off)
        else:
            rest = share[others]
            rest = rest[np.isfinite(rest)]
            if not np.isfinite(share[j]) or len(rest) < 2 or np.ptp(np.log(rest)) > 2 * math.log(DRY_ODD):
                continue
            off = math.log(share[j] / float(np.median(rest)))
            # a joint may have no dry friction; in another unit its whole reading is small
            small = whole[j] * DRY_ODD < float(np.nanmedian(whole[others]))
            odd = abs(off) > math.log(DRY_ODD) and (share[j] > max(rest) * 3 or (small and share[j] < min(rest) / 3))
        if odd:
            c = Correction("scale", "tau", (j,), float(f"{math.exp(off):.3g}"))
            sentence = f"the torque (or current) of {name} is {math.exp(off):.3g} times what the other joints suggest: a gear ratio or a unit"
            out.append(Cause(sentence, abs(off), (c,), (math.exp(off), math.exp(off))))
    return sorted(out, key=lambda cause: -cause.gain)


def _dry_too(share: np.ndarray, j: int, off: float) -> bool:
    """Whether dry friction has the same scale, as with a unit or a gear ratio; a load only makes a wrist's masses up to ten times too light."""
    rest = np.delete(share, j)
    rest = rest[np.isfinite(rest)]
    if not np.isfinite(share[j]) or len(rest) < 2:
        return off < 0 or off > math.log(ODD_LOADED)
    return bool(math.log(share[j] / float(np.median(rest))) / off > 0.5)


def _beyond(arm: Arm, s: Signals, scale: Scale, from_current: np.ndarray) -> list[Cause]:
    """Causes of readings that the arm cannot give, where masses are not informative; where masses confirm the scale, the stated limit is wrong."""
    right = scale.informative & (np.abs(np.where(scale.informative, scale.log_scale, np.inf)) < math.log(ODD))
    wrong = scale.impossible & ~right
    if not wrong.any() or (scale.impossible & right).any():
        return []
    most = np.nanmax(np.abs(s.load), axis=0)
    j = int(np.argmax(np.where(wrong, most / arm.tau_max, 0)))
    c = Correction("unit", "current", unit="mA") if from_current[j] else Correction("unit", "tau", unit="mNm")
    if wrong.sum() < max(2, scale.impossible.size / 2):
        c = Correction("scale", "tau", (j,), float(f"{most[j] / (0.3 * arm.tau_max[j]):.2g}"))
    factor = float(most[j] / arm.tau_max[j])
    return [Cause(c.sentence(arm.joint_names), math.log(factor), (c,), (factor, factor))]


def _off(x: np.ndarray) -> float:
    return float(np.median(np.abs(x)))
