"""What the stamps of a recording say: order, duplicates, gaps and rate of the samples on the device clock."""

from __future__ import annotations

import numpy as np

from logs.damage import Damage

GAP_FACTOR = 2.5  # a step longer than this many median steps is a gap


def check_times(t: np.ndarray, damage: Damage) -> None:
    """BadLog where time runs backwards; sentences about duplicates and gaps. t (N,) s, device clock."""
    if len(t) < 2:
        return
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
        damage.note(f"{len(same)} samples carry the stamp of the sample before, first at {t[same[0] + 1]:.4f} s")
    median = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    gaps = np.flatnonzero(steps > GAP_FACTOR * median)
    if len(gaps):
        k = gaps[np.argmax(steps[gaps])]
        lost = int(np.sum(np.rint(steps[gaps] / median) - 1))
        damage.note(
            f"{len(gaps)} gaps of more than {GAP_FACTOR:g} sample periods, the longest {steps[k] * 1e3:.1f} ms at {t[k]:.4f} s; "
            f"about {lost} samples are missing"
        )
