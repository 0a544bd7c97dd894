"""Findings about the sampling of a recording, as sentences."""

from __future__ import annotations

import numpy as np

from logs.elapsed import TRUST
from logs.timing import shared_stamps

MATTERS = 0.03  # of a period: less jitter than this is ignored


def repeats(held: np.ndarray, stale: np.ndarray, first: np.ndarray, n: int) -> list[str]:
    out = []
    twice = int((held & ~stale).sum())
    if twice:
        out.append(
            f"{twice} of {n} samples repeat{'s' * (twice == 1)} the one before while the arm moves (one in {n / twice:.1f}); they are left out"
        )
    if stale.any():
        out.append(
            f"in {int(stale.sum())} of {n} samples the position repeats that of the sample before while other channels are new"
        )
    if not first.all():
        count = int((~first).sum())
        out.append(
            f"{shared_stamps(count)} and {'are' if count > 1 else 'is'} left out: two readings at one instant have no derivative"
        )
    return out


def of_jitter(
    jitter: float,
    seen: float,
    rebuilt: bool,
    left: float,
    period: float,
    stamps: np.ndarray,
    clock: np.ndarray,
    set_forward: bool,
) -> str:
    sentence = (
        f"the stamps jitter by {1e3 * jitter:.3g} ms about the instants of sampling (standard deviation, from q against dq)"
    )
    if rebuilt:
        most = float(np.quantile(np.abs(stamps - clock), 0.99))
        return (
            f"{sentence}, one in a hundred by over {1e3 * most:.2g} ms; the clock was rebuilt: a sample every {1e3 * period:.6g} ms, "
            f"{1e3 * left:.2g} ms remain between q and dq"
        )
    if jitter > 2 * seen and jitter > MATTERS * period:
        return f"{sentence}; the clock could not be rebuilt from these readings, and the stamps are kept as they are"
    agree = f"the stamps agree with q and dq within {1e3 * left:.2g} ms, {left / period:.1%} of a period"
    return f"{agree}{' except where the clock was set' if set_forward else ''}; the readings resolve {1e3 * seen:.2g} ms"


def of_missing(count: np.ndarray) -> str:
    """Sentence about the samples lost between neighbours (K,); there are some."""
    missing, places = int(count.sum()), int((count > 0).sum())
    return f"{missing} sample{'s are' if missing > 1 else ' is'} missing in {places} place{'s' * (places > 1)}, at most {count.max()} in a row"


def of_speed(scale: np.ndarray) -> list[str]:
    odd = np.flatnonzero(np.abs(scale - 1) > TRUST)
    if not len(odd):
        return []
    values = ", ".join(f"{scale[j]:.3g} (joint {j + 1})" for j in odd)
    return [f"dq is not the derivative of q but a multiple of it: {values}; it was not used there"]
