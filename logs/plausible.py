"""Damaged samples: not finite, beyond what any arm gives in any unit, or a jump far above the recording's own speeds.

A recording that is entirely in another unit is not damaged. Whether the readings are of this arm is for the gate to decide
(calib.gate).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

VALUE_MAX = {"q": 1e5, "dq": 2e4, "tau": 1e7, "current": 1e6, "temperature": 1e3}
UNIT = {"q": "rad", "dq": "rad/s", "tau": "N m", "current": "A", "temperature": "degC"}
STEP_SPEED_MAX = 100.0  # rad/s: several times what the fastest servo joint reaches
STEP_SPEED_WILD = 1e5  # rad/s: out of reach even in degrees on the motor side of a gear
STEP_RATIO, STEP_QUANTILE, STEP_ROWS = (
    5.0,
    0.9,
    50,
)  # times the speed that a tenth of the steps exceeds; needs more than STEP_ROWS samples
STEP_SLACK = 0.01  # rad, noise of a reading
ROWS = 1 << 16  # processed together: an hour's arrays are never held twice


@dataclass(frozen=True, slots=True)
class Fault:
    """One value that breaks a rule: sample, name of the channel, joint column, value, rule."""

    sample: int
    channel: str
    joint: int
    value: float
    rule: str


def first_fault(t: np.ndarray, channels: dict[str, np.ndarray]) -> Fault | None:
    """The earliest sample that breaks a rule, or None.

    Rules: q is finite, nothing is infinite, |x| <= VALUE_MAX, no impossible step.
    """
    faults = [f for f in (_first(name, values) for name, values in channels.items() if values.strides[0]) if f is not None]
    step = _first_step(t, channels["q"])
    if step is not None:
        faults.append(step)
    return min(faults, key=lambda fault: fault.sample) if faults else None


def bad_samples(t: np.ndarray, channels: dict[str, np.ndarray]) -> np.ndarray:
    """(N,) bool: samples that break a rule. After a jump, the samples off the majority's level are bad."""
    bad = np.zeros(len(t), dtype=bool)
    for name, values in channels.items():
        if values.strides[0]:
            bad |= ~_sound(name, values).all(axis=1)
    good = np.flatnonzero(~bad)
    if len(good) > 1:
        bad[good[_off_level(t[good], channels["q"][good])]] = True
    return bad


def _sound(name: str, values: np.ndarray) -> np.ndarray:
    most, out = VALUE_MAX[name], np.empty(values.shape, dtype=bool)
    with np.errstate(invalid="ignore"):
        for at in range(0, len(values), ROWS):
            part = values[at : at + ROWS]
            inside = np.abs(part) <= most
            out[at : at + ROWS] = inside if name == "q" else inside | np.isnan(part)
    return out


def _first(name: str, values: np.ndarray) -> Fault | None:
    sound = _sound(name, values)
    if sound.all():
        return None
    sample, joint = np.argwhere(~sound)[0]
    return Fault(
        int(sample), name, int(joint), float(values[sample, joint]), f"finite and at most {VALUE_MAX[name]:g} {UNIT[name]}"
    )


def _step_speed(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(n,) rad/s that no step may exceed: STEP_SPEED_MAX, or more where the recording's own steps suggest another unit."""
    least = np.full(q.shape[1], STEP_SPEED_MAX)
    if len(q) <= STEP_ROWS:
        return least
    at = np.unique(np.linspace(0, len(q) - 2, min(len(q) - 1, ROWS)).astype(int))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        speed = np.abs(q[at + 1] - q[at]) / np.abs(t[at + 1] - t[at])[:, None]
    speed[~np.isfinite(speed)] = 0.0
    return np.clip(STEP_RATIO * np.quantile(speed, STEP_QUANTILE, axis=0), STEP_SPEED_MAX, STEP_SPEED_WILD)


def _usual_step(t: np.ndarray) -> float:
    """Median step of t, s; 0 where there is none.

    Stamps of a late host come in bursts, and the time between two of a burst does not reflect the motion.
    """
    steps = np.diff(t)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return usual if np.isfinite(usual) and usual > 0 else 0.0


def _steps(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    most, usual = _step_speed(t, q), _usual_step(t)
    out = np.empty((max(len(q) - 1, 0), q.shape[1]), dtype=bool)
    with np.errstate(invalid="ignore", over="ignore"):
        for at in range(0, len(out), ROWS):
            part = slice(at, at + ROWS + 1)
            reach = np.maximum(np.abs(np.diff(t[part])), usual)[:, None] * most + STEP_SLACK
            out[at : at + ROWS] = np.abs(np.diff(q[part], axis=0)) > reach
    return out


def _first_step(t: np.ndarray, q: np.ndarray) -> Fault | None:
    jumps = _steps(t, q)
    if not jumps.any():
        return None
    k, joint = np.argwhere(jumps)[0]
    most = _step_speed(t, q)[joint]
    rule = f"within {most:.3g} rad/s of the sample before ({q[k, joint]:g} rad, {t[k + 1] - t[k]:.4g} s earlier)"
    return Fault(int(k) + 1, "q", int(joint), float(q[k + 1, joint]), rule)


def _off_level(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N,) bool: samples of pieces out of reach of the longest one; a piece holds no impossible step."""
    cuts = np.flatnonzero(_steps(t, q).any(axis=1)) + 1
    off = np.zeros(len(t), dtype=bool)
    if not len(cuts):
        return off
    most, usual = _step_speed(t, q), _usual_step(t)
    starts, ends = np.r_[0, cuts], np.r_[cuts, len(t)]
    longest = int(np.argmax(ends - starts))
    for order, edge in ((range(longest + 1, len(starts)), 1), (range(longest - 1, -1, -1), -1)):
        anchor = ends[longest] - 1 if edge > 0 else starts[longest]
        for k in order:
            near, far = (starts[k], ends[k] - 1) if edge > 0 else (ends[k] - 1, starts[k])
            reach = most * max(abs(t[near] - t[anchor]), usual) + STEP_SLACK
            if np.all(np.abs(q[near] - q[anchor]) <= reach):
                anchor = far
            else:
                off[starts[k] : ends[k]] = True
    return off
