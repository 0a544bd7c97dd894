"""When were the samples of a recording really taken? Found from position against speed, not from the stamps alone.

Between two samples the position moves by dq (t1 - t0), whatever the stamps say. With n joints in motion, d = sum w dq Dq / sum
w dq^2 is the time that really passed, w the inverse variance of each joint's Dq - dq d.

- d differs from the stamps by more than the readings allow: the stamps jitter.
- The position stands still although the arm moves: a sample was sent twice.
- d is a multiple of the period: samples were lost.

Nothing is repaired silently: `findings` states what was found and what was done. Every bridged value is marked, and its
standard deviation is measured by bridging samples that were not lost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from logs.bridging import bridge, bridging_error
from logs.clock_steps import set_forward
from logs.elapsed import LEAST_INFORMATIVE, TRUST, elapsed_between
from logs.lost_time import finding, lost_time
from logs.normal import OF_MEDIAN
from logs.rate_change import change_of_rate
from logs.sampling_clock import rebuilt_clock
from logs.sampling_findings import MATTERS, of_jitter, of_missing, of_speed, repeats

LEAST_SAMPLES = 32
REACH = 5  # samples before and after, over which a joint must keep moving for an unchanged position to be a repeat
COUNTS = 3.0  # encoder steps per sample: below, an unchanged position is to be expected
FAST_SHARE = 0.15  # of a period: samples whose motion resolves time better than this are informative
MOST_BRIDGED = 8  # samples in a row
GAP_STEPS, GAP_STEPS_REGULAR = 2.5, 1.5
STEADY_SHARE, STEADY_WITHIN = 0.95, 0.1


@dataclass(frozen=True)
class Sampling:
    """M samples at the times at which they were taken, and the properties of stamps and samples.

    t           (M,) s, increasing
    source      (M,) row of the recording, -1 for a bridged sample
    channels    name -> (M, n); as recorded except where `bridged`
    bridged     name -> (M,) bool, values that were not measured
    std         name -> (M, n) standard deviation of the bridged values, 0 where measured
    period      s, between samples: the device's where its clock was rebuilt, else the median step of the stamps
    jitter      s, standard deviation of the stamps about the sample times; NaN where the motion does not show it
    jitter_seen s, the smallest jitter that this motion and resolution would have shown
    rebuilt     whether `t` differs from the stamps
    left        s, robust standard deviation of d about the steps of the clock; NaN where the motion does not show it
    repeated, missing   number of samples sent twice (left out), and of samples lost
    dq_scale    (n,) dq over the derivative of q, NaN where a joint does not move; 1 unless unit, sign or clock is wrong
    findings    sentences
    losses      those of them about lost samples and the rate that no reader finds by itself
    """

    t: np.ndarray
    source: np.ndarray
    channels: dict[str, np.ndarray]
    bridged: dict[str, np.ndarray]
    std: dict[str, np.ndarray]
    period: float
    jitter: float
    jitter_seen: float
    rebuilt: bool
    left: float
    repeated: int
    missing: int
    dq_scale: np.ndarray
    findings: tuple[str, ...]
    losses: tuple[str, ...] = ()


def examine(
    t: np.ndarray, q: np.ndarray, dq: np.ndarray | None = None, others: Mapping[str, np.ndarray] | None = None,
    *, bridging: bool = True,
) -> Sampling:  # fmt: skip
    """Examine stamps t (N,) s, which must not decrease, positions q (N, n) rad, speeds dq (N, n) rad/s, other channels (N, n).

    Without `bridging` no value is added: samples sent twice are left out, and the clock is rebuilt where possible. ValueError
    where the shapes differ, t decreases, or t or q is not finite.
    """
    others = dict(others or {})
    nothing = np.full(q.shape, np.nan)
    dq = nothing if dq is None else dq
    _check(t, q, {"dq": dq, **others})
    if len(t) < LEAST_SAMPLES:
        channels = {"q": q, "dq": dq, **others}
        too_few = (f"{len(t)} samples are too few to determine how they were taken",)
        return _as_recorded(t, channels, too_few)
    held = _held(q)
    stale = held & ~_same(others)
    first = np.r_[True, np.diff(t) > 0]
    fresh = np.flatnonzero(~held & first)
    if len(fresh) < LEAST_SAMPLES:
        return _as_recorded(
            t, {"q": q, "dq": dq, **others}, ("nearly every sample repeats the one before: nothing can be determined",)
        )
    tf, qf, vf = t[fresh], q[fresh], dq[fresh]
    steps = np.diff(tf)
    period = float(np.median(steps))
    elapsed, error, scale = elapsed_between(steps, qf, vf)
    informative = error < FAST_SHARE * period
    forward = np.zeros(len(steps))
    gaps = np.flatnonzero(steps > GAP_STEPS * period)
    forward[gaps] = set_forward(tf, qf, vf, gaps)
    jitter, seen, rebuilt, left = math.nan, math.nan, False, math.nan
    clock = tf
    findings = repeats(held, stale, first, len(t))
    if informative.sum() >= LEAST_INFORMATIVE:
        off = elapsed[informative] - steps[informative]
        seen = float(np.median(error[informative]))
        left = OF_MEDIAN * float(np.median(np.abs(off - np.median(off))))
        excess = math.sqrt(max(left**2 - seen**2, 0.0))
        jitter = excess / math.sqrt(2) if excess > seen else 0.0
        if excess > 2 * seen and excess > MATTERS * period:
            made = rebuilt_clock(tf, elapsed, np.where(informative, error, np.inf), excess)
            if made is not None:
                clock, rebuilt, period = made.t, True, made.period
                jitter = OF_MEDIAN * float(np.median(np.abs(tf - clock - np.median(tf - clock))))
                left = OF_MEDIAN * float(np.median(np.abs(elapsed - np.diff(clock))[informative]))
        findings.append(of_jitter(jitter, seen, rebuilt, left, period, tf, clock, bool(forward.any())))
    else:
        findings.append(
            "jitter of the stamps cannot be determined: dq is not the derivative of q, or no motion is fast enough for its resolution"
        )
    findings += of_speed(scale)
    unseen = finding(lost_time(clock, qf, vf))
    findings += [unseen] if unseen else []
    changed = change_of_rate(clock)
    count = _missing(np.diff(clock), changed.periods if changed else period, rebuilt, informative)
    count = np.where(forward > 0, 0, np.maximum(count - np.diff(np.cumsum(~first)[fresh]), 0))
    missing = int(count.sum())
    of_rate, of_losses = [changed.sentence] if changed else [], [of_missing(count)] if missing else []
    findings += of_rate + of_losses
    losses = of_rate + (of_losses if (count == 1).any() else [])  # a reader reports no step of two periods as a gap
    findings += [f"gaps of up to {MOST_BRIDGED} samples are bridged and marked"] if missing and bridging else []
    keep = np.sort(np.concatenate([fresh, np.flatnonzero(stale & first)]))
    at = np.interp(t[keep], tf, clock) if len(keep) > len(fresh) else clock
    channels = {"q": q[keep], "dq": dq[keep], **{name: x[keep] for name, x in others.items()}}
    old = {name: (stale[keep] if name in ("q", "dq") else np.zeros(len(keep), dtype=bool)) for name in channels}
    if not bridging:
        zero = {name: np.zeros_like(x) for name, x in channels.items()}
        return Sampling(
            at,
            keep,
            channels,
            old,
            zero,
            period,
            jitter,
            seen,
            rebuilt,
            left,
            int((held & ~stale).sum()),
            missing,
            scale,
            tuple(findings),
            tuple(losses),
        )
    derived = bool(np.all(np.isnan(scale) | (np.abs(scale - 1) < TRUST)) and np.isfinite(dq).all())
    errors = bridging_error(at, channels, old["q"], MOST_BRIDGED, derived)
    grid = bridge(at, channels, old, _counts_between(at, clock, count), MOST_BRIDGED, errors, derived)
    source = np.where(grid.row >= 0, keep[np.maximum(grid.row, 0)], -1)
    worst = {name: x.max(initial=0.0) for name, x in grid.std.items()}
    if (source < 0).any() or stale.any():
        findings.append(
            f"{int(grid.bridged['q'].sum())} positions were bridged, with a standard deviation of at most {worst['q']:.2g} rad, "
            "measured by bridging samples that were not lost"
        )
    return Sampling(
        grid.t, source, grid.channels, grid.bridged, grid.std, period, jitter, seen, rebuilt, left, int((held & ~stale).sum()), missing, scale,
        tuple(findings), tuple(losses),
    )  # fmt: skip


def _check(t: np.ndarray, q: np.ndarray, others: Mapping[str, np.ndarray]) -> None:
    if t.ndim != 1 or q.ndim != 2 or len(q) != len(t):
        raise ValueError(f"t (N,) and q (N, n) are needed, got {t.shape} and {q.shape}")
    for name, x in others.items():
        if x.shape != q.shape:
            raise ValueError(f"{name} must be {q.shape} like q, got {x.shape}")
    if not (np.isfinite(t).all() and np.isfinite(q).all()):
        raise ValueError("t and q must be finite; leave out the samples in which they are not")
    if np.any(np.diff(t) < 0):
        raise ValueError(f"t decreases at sample {int(np.argmax(np.diff(t) < 0)) + 1}")


def _as_recorded(t: np.ndarray, channels: dict[str, np.ndarray], findings: tuple[str, ...]) -> Sampling:
    none = {name: np.zeros(len(t), dtype=bool) for name in channels}
    zero = {name: np.zeros_like(x) for name, x in channels.items()}
    period = float(np.median(np.diff(t))) if len(t) > 1 else math.nan
    unknown = np.full(channels["q"].shape[1], np.nan)
    return Sampling(
        t, np.arange(len(t)), channels, none, zero, period, math.nan, math.nan, False, math.nan, 0, 0, unknown, findings
    )


def _held(q: np.ndarray) -> np.ndarray:
    """(N,) bool: no position changed although a joint keeps moving, several encoder steps per sample on both sides."""
    change = np.diff(q, axis=0)
    size = np.abs(change)
    resolution = np.array([np.quantile(x[x > 0], 0.01) if (x > 0).any() else np.inf for x in size.T])
    ahead, behind = np.zeros_like(change), np.zeros_like(change)
    ahead[: -REACH + 1] = (q[REACH:] - q[:-REACH]) / REACH
    behind[REACH - 1 :] = (q[REACH:] - q[:-REACH]) / REACH
    through = (np.minimum(np.abs(ahead), np.abs(behind)) >= COUNTS * resolution) & (ahead * behind > 0)
    return np.r_[False, (change == 0).all(axis=1) & through.any(axis=1)]


def _same(others: Mapping[str, np.ndarray]) -> np.ndarray:
    """(N,) bool: no other channel changed either; missing readings count as unchanged."""
    same: np.ndarray = np.array(True)
    for x in others.values():
        equal = (np.diff(x, axis=0) == 0) | np.isnan(x[1:])
        same = same & np.r_[False, equal.all(axis=1)]
    return same


def _missing(steps: np.ndarray, period: float | np.ndarray, rebuilt: bool, informative: np.ndarray) -> np.ndarray:
    """(K,) samples lost between neighbours, from steps above GAP_STEPS periods.

    GAP_STEPS_REGULAR is enough where the clock is even; on a rebuilt clock, for informative steps only.
    """
    of = steps / period
    even = rebuilt or np.mean(np.abs(of - np.rint(of)) < STEADY_WITHIN) > STEADY_SHARE
    lost = of > np.where(informative | (not rebuilt), GAP_STEPS_REGULAR if even else GAP_STEPS, GAP_STEPS)
    return np.where(lost, np.rint(of) - 1, 0).astype(int)


def _counts_between(at: np.ndarray, clock: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Counts of lost samples, moved to the steps of `at`, which includes the times `clock`; 0 where a stale sample is between."""
    if len(at) == len(clock):
        return count
    out = np.zeros(len(at) - 1, dtype=int)
    place = np.searchsorted(at, clock[:-1])
    alone = np.searchsorted(at, clock[1:]) == place + 1
    out[place[alone]] = count[alone]
    return out
