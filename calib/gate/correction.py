"""One way to read a recording: a unit, a sign, a column, a clock. The same words name it for `--assume`.

t=ms                 instants are in ms (us, ns, min)
q=deg  dq=deg/s      all positions are in degrees (rev), all speeds in deg/s (rpm, rev/s)
current=mA  tau=mNm  readings of the drives are in thousandths
current=int16 tau=int16  the raw numbers are signed words that were stored as unsigned ones (65535 is -1); int32 too
tau=current          what is recorded as torque is a current in A
sign:tau:elbow       the sign of one joint's reading is reversed (tau: torque or current; q, dq, motion, all)
swap:all:a,b         the columns of two joints are exchanged (tau, q, dq, or all)
scale:tau:elbow=101  one joint's reading is this many times too large (tau, q, dq; a gear ratio)
scale:tau=0.1        the same for all joints
zero:q:elbow=1.5708  one joint's position is this many rad too large: its zero is not the model's
shift=0.25           torque or current lags the positions by this many s
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.column_map import DRIVE
from logs.log import CHANNELS, Log
from logs.units import ANGLE, SPEED, TIME
from logs.words import BITS, signed
from sim.errors import ConfigError
from sim.resources import nearest

PARTS = ("q", "dq", "motion", "tau", "all")
UNITS = {"t": TIME, "q": ANGLE, "dq": SPEED, "current": {"mA": 1e-3}, "tau": {"mNm": 1e-3}}
ARRAYS = {
    "q": ("q", "q_cmd"), "dq": ("dq", "dq_cmd"), "motion": ("q", "dq", "q_cmd", "dq_cmd"), "tau": ("tau", "current", "tau_cmd"),
    "all": CHANNELS,
}  # fmt: skip
SIGNED = tuple(name for name in ARRAYS["all"] if name != "temperature")
CURRENT = "tau=current"
AS_RECORDED = "as-recorded"
ASSUMED = "assumed"  # the metadata key under which a log states how it is read


@dataclass(frozen=True)
class Correction:
    """kind: unit, word, sign, swap, scale, zero, shift or current; part: t, q, dq, motion, tau, current or all; joints: columns, none for all;
    factor: the reading is divided by it (scale), reduced by it, rad (zero), or moved earlier by it, s (shift); unit: of unit and word."""

    kind: str
    part: str = "all"
    joints: tuple[int, ...] = ()
    factor: float = 1.0
    unit: str = ""

    def word(self, names: Sequence[str]) -> str:
        """The word for `--assume`."""
        at = ",".join(names[j] for j in self.joints)
        match self.kind:
            case "unit" | "word":
                return f"{self.part}={self.unit}"
            case "current":
                return CURRENT
            case "shift":
                return f"shift={self.factor:.4g}"
            case "scale":
                return f"scale:{self.part}:{at}={self.factor:.4g}" if at else f"scale:{self.part}={self.factor:.4g}"
            case "zero":
                return f"zero:{self.part}:{at}={self.factor:.7g}"
        return f"{self.kind}:{self.part}:{at}"

    def sentence(self, names: Sequence[str]) -> str:
        """What would be wrong with the recording."""
        at = [names[j] for j in self.joints]
        readings = {
            "q": "the position",
            "dq": "the speed",
            "motion": "the motion",
            "tau": "the torque (or current)",
            "all": "every reading",
        }
        reading = readings.get(self.part, "")
        match self.kind:
            case "unit" if self.part == "t":
                return f"the instants are in {self.unit}, not in s"
            case "word":
                return f"the raw numbers of the {'currents' if self.part == 'current' else 'torques'} are signed words kept as unsigned ones"
            case "unit":
                own = {"q": "rad", "dq": "rad/s", "current": "A", "tau": "N m"}[self.part]
                what = {"q": "positions", "dq": "speeds", "current": "currents", "tau": "torques"}[self.part]
                return f"the {what} are in {'mN m' if self.unit == 'mNm' else self.unit}, not in {own}"
            case "current":
                return "the recorded torque is motor current in A"
            case "sign":
                return f"{reading} of {at[0]} has the wrong sign"
            case "swap":
                columns = "the columns" if self.part == "all" else f"{reading} columns"
                return f"{columns} of {' and '.join(at)} are swapped"
            case "scale":
                whose = f"of {at[0]} " if at else "of every joint "
                return f"{reading} {whose}is {self.factor:.3g} times too large (gear ratio or unit)"
            case "zero":
                return f"{reading} of {at[0]} is {self.factor:.4g} rad ({math.degrees(self.factor):.0f} deg) too large: another zero than the model's"
        way = "lags" if self.factor > 0 else "leads"
        return f"the torque (or current) {way} the positions by {abs(self.factor):.3g} s: another clock"


def applied(log: Log, correction: Correction) -> Log:
    """The log read that way; its metadata record this under `assumed`."""
    c = correction
    change: dict[str, object] = {}
    match c.kind:
        case "unit" if c.part == "t":
            change = {"t": log.t * TIME[c.unit]}
        case "word":
            change = {c.part: signed(getattr(log, c.part), c.unit)}
        case "unit" | "scale":
            names = ("current",) if c.part == "current" else ("tau",) if c.unit == "mNm" else ARRAYS[c.part]
            factor = np.ones(log.n)
            factor[list(c.joints) if c.joints else slice(None)] = 1 / c.factor if c.kind == "scale" else UNITS[c.part][c.unit]
            change = {name: getattr(log, name) * factor for name in names}
        case "zero":
            off = np.zeros(log.n)
            off[list(c.joints)] = c.factor
            change = {name: getattr(log, name) - off for name in ARRAYS["q"]}
        case "current":
            nothing = np.full(log.tau.shape, np.nan)
            change = {"current": np.where(np.isfinite(log.current), log.current, log.tau), "tau": nothing}
        case "sign":
            sign = np.ones(log.n)
            sign[list(c.joints)] = -1
            change = {name: getattr(log, name) * sign for name in ARRAYS[c.part] if name in SIGNED}
        case "swap":
            order = np.arange(log.n)
            order[list(c.joints)] = order[list(c.joints[::-1])]
            change = {name: getattr(log, name)[:, order] for name in ARRAYS[c.part]}
        case "shift":
            change = {name: _earlier(log.t, getattr(log, name), c.factor) for name in ("tau", "current")}
    words = [*assumed(log), c.word(log.joint_names)]
    return replace(log, **change, metadata={**log.metadata, ASSUMED: json.dumps(words, ensure_ascii=False)})  # type: ignore[arg-type]


def assumed(log: Log) -> list[str]:
    """How a log is read, in words of `--assume`; empty where its metadata state none, or nothing readable."""
    try:
        words = json.loads(log.metadata.get(ASSUMED, "[]"))
    except (ValueError, RecursionError):
        return []
    return [word for word in words if isinstance(word, str)] if isinstance(words, list) else []


def _earlier(t: np.ndarray, x: np.ndarray, by: float) -> np.ndarray:
    if not np.isfinite(x).any():
        return x
    out = np.stack([np.interp(t + by, t, column, left=np.nan, right=np.nan) for column in x.T], axis=1)
    return out


def parsed(text: str, names: Sequence[str]) -> Correction:
    """The correction that a word of `--assume` names; ConfigError suggests valid words."""
    head, colon, rest = text.partition(":")
    if not colon:
        return _of_all(text)
    if head not in ("sign", "swap", "scale", "zero"):
        raise ConfigError(f"--assume {text!r:.80}: {nearest(head[:40], ('sign', 'swap', 'scale', 'zero', *UNITS, 'shift'))}")
    part, colon, where = rest.partition(":")
    if head == "scale" and not colon:
        part, _, number = part.partition("=")
        return Correction("scale", _part(part, text), (), _factor(number, text))
    where, equals, number = where.partition("=")
    joints = tuple(_joint(name.strip(), names, text) for name in where.split(","))
    if len(joints) != (2 if head == "swap" else 1) or len(set(joints)) != len(joints):
        raise ConfigError(f"--assume {text!r:.80}: {'two different joints' if head == 'swap' else 'one joint'} must be named")
    number_of = {"scale": "=FACTOR", "zero": "=RAD"}.get(head, "")
    if bool(number_of) != bool(equals) or (head == "zero" and part != "q"):
        raise ConfigError(f"--assume {text!r:.80}: write {head}:{'q' if head == 'zero' else 'PART'}:JOINT{number_of}")
    return Correction(head, _part(part, text), joints, _factor(number, text) if equals else 1.0)


def _of_all(text: str) -> Correction:
    part, _, value = text.partition("=")
    if text == CURRENT:
        return Correction("current", "tau")
    if part == "shift":
        return Correction("shift", "tau", (), _factor(value, text))
    if part in DRIVE and value in BITS:
        return Correction("word", part, unit=value)
    if part not in UNITS or value not in UNITS[part]:
        known = [f"{p}={u}" for p, units in UNITS.items() for u in units if units[u] != 1.0]
        known += [f"{p}={u}" for p in DRIVE for u in BITS]
        raise ConfigError(
            f"--assume {text!r:.80}: {nearest(text[:40], [*known, CURRENT, 'sign:tau:JOINT', 'swap:all:JOINT,JOINT', AS_RECORDED])}"
        )
    return Correction("unit", part, (), 1.0, value)


def _part(part: str, text: str) -> str:
    if part not in PARTS or (text.startswith("scale") and part == "all"):
        raise ConfigError(f"--assume {text!r:.80}: {nearest(part[:40], PARTS)}")
    return part


def _joint(name: str, names: Sequence[str], text: str) -> int:
    if name not in names:
        raise ConfigError(f"--assume {text!r:.80}: there is no joint {name!r:.40}; {nearest(name[:40], names)}")
    return list(names).index(name)


def _factor(number: str, text: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value == 0 or not 1e-9 < abs(value) < 1e9:
        raise ConfigError(f"--assume {text!r:.80}: {number!r:.40} is not a number to divide by, to subtract or to shift by")
    return value
