"""What the stamps of a recording show: order, counters that wrapped around, duplicates, gaps, too coarse a resolution."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from logs.clock_fit import ClockFit, fit_clocks
from logs.clock_steps import finding, set_forward
from logs.damage import Damage

COLUMN_MAP = "column_map"  # in the metadata of a log that was a table
GAP_FACTOR = 2.5  # a step longer than this many median steps is a gap
# counters of 16, 31 and 32 bits that count ns, us, ms or 1/10 ms
WRAP_PERIODS = tuple(2.0**bits * tick for bits in (16, 31, 32) for tick in (1e-9, 1e-6, 1e-4, 1e-3))


def coarse(t: np.ndarray, *readings: np.ndarray) -> str:
    """Why the stamps t (N,) s do not distinguish the samples, each of `readings` (N, n); "" where they do.

    They do not where most samples carry the stamp of the sample before with a new reading.
    """
    same = np.diff(t) == 0
    with np.errstate(invalid="ignore"):
        new = np.any([(np.abs(np.diff(x, axis=0)) > 0).any(axis=1) for x in readings], axis=0)
    if 2 * np.count_nonzero(same & new) <= len(same):
        return ""
    return (
        f"{np.count_nonzero(same)} of {len(t)} samples carry the stamp of the sample before, most with new readings: the stamps are coarser than "
        "the samples"
    )


def finer(metadata: Mapping[str, str]) -> str:
    """Remedy for coarse stamps, by a log's metadata: only a table may be read without its time."""
    if COLUMN_MAP in metadata:
        return "give stamps that distinguish the samples, or the rate of even samples: `calib import --rate HZ`"
    return "record it again with stamps that distinguish the samples"


def checked_times(
    t: np.ndarray, t_host: np.ndarray, damage: Damage, motion: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[np.ndarray, ClockFit | None]:
    """Return the times t (N,) s with wrap-arounds of counters undone, and the fit of the clocks where there is a host clock.

    motion: q and dq (N, n), which show whether a gap in the stamps is a clock that was set. BadLog where time runs backwards
    otherwise. Wrap-arounds, duplicates, gaps, skew and jumps are noted as findings.
    """
    if len(t) < 2:
        return t, None
    t = unwrapped(t, damage)
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = int(back[0])
        raise damage.refuse(
            f"sample {k + 1}", f"device time runs back from {t[k]:.6f} s to {t[k + 1]:.6f} s ({len(back)} times in all)",
            "the device clock must not be set during a recording; record it again, or cut the file there",
        )  # fmt: skip
    same = np.flatnonzero(steps == 0)
    if len(same):
        damage.note(f"{shared_stamps(len(same))}, first at {t[same[0] + 1]:.4f} s")
    median = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    gaps = np.flatnonzero(steps > GAP_FACTOR * median)
    if motion is not None:
        forward = set_forward(t, *motion, gaps)
        for place in np.flatnonzero(forward):
            damage.note(finding(t[gaps[place]], forward[place]))
        gaps = gaps[forward == 0]
    if len(gaps):
        k = gaps[np.argmax(steps[gaps])]
        lost = int(np.sum(np.rint(steps[gaps] / median) - 1))
        damage.note(
            f"{len(gaps)} gap{'s' * (len(gaps) > 1)} of more than {GAP_FACTOR:g} sample periods, the longest {steps[k] * 1e3:.1f} ms at "
            f"{t[k]:.4f} s; about {lost} samples are missing"
        )
    clock = fit_clocks(t, t_host)
    if clock is not None:
        for sentence in clock.findings():
            damage.note(sentence)
    return t, clock


def shared_stamps(count: int) -> str:
    """Beginning of a sentence about samples that share a stamp."""
    return (
        f"{count} samples carry the stamp of the sample before"
        if count > 1
        else "1 sample carries the stamp of the sample before"
    )


def unwrapped(t: np.ndarray, damage: Damage) -> np.ndarray:
    """t with whole counter periods added, if every step back is the period of a known counter less about one sample."""
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0)
    forward = steps[steps > 0]
    if not len(back) or not len(forward) or len(forward) < len(steps) // 2:
        return t
    median = float(np.median(forward))
    for period in WRAP_PERIODS:
        over = steps[back] + period
        if period > 100 * median and np.all((over > 0) & (over < GAP_FACTOR * median)):
            damage.note(
                f"the device counter wrapped around {len(back)} times (period {period:.9g} s), first at {t[back[0]]:.4f} s; "
                "whole periods were added"
            )
            return t + period * np.concatenate([[0], np.cumsum(steps < 0)])
    return t
