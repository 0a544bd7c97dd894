"""d(q) - sum_j R_j (w_j + e) >= margin for every pair of bodies: clearance that is verified, not sampled, also beside the path.

A piece of motion lies in a box of joint angles with half-widths w. Two bodies come no closer than their distance at the box's
centre, less reach times half-width of every joint between them. One distance thus verifies a whole piece, with every joint up
to e off it. What it does not verify is cut in two, down to single pieces of the motion and then parts of them (bound of
Schwarzer, Saha, Latombe 2005, doi:10.1109/TRO.2004.838012, section III). What stays undecided is refused.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safety.collision import GJK, Clearance
from safety.sheets import Sheet
from sim.errors import SafetyStop

# most boxes into which one part of a motion is cut
HALVES = 400
# fewer for larger boxes, of at most so many rows, because their rows may be verified one by one
FEW_HALVES, FEW_ROWS = 48, 128
# share of the room at a box's centre that must be verified before the box is good enough
SHARE = 0.5
# bounds lo hi (n,) rad, and the pairs that are checked in it
Box = tuple[np.ndarray, np.ndarray, np.ndarray]


def certify(clearance: Clearance, sheet: Sheet, what: str, least: float, most: float) -> np.ndarray:
    """(K,) rad: how far every joint may be off each row of `sheet` with every pair's margin kept, at most `most`.

    SafetyStop with the witness if that is less than `least`: a pair comes closer than its margin, or could not be decided.
    """
    if not sheet.boxes.finite():
        raise SafetyStop(f"{what}: a posture is not finite; it is not checked for collision")
    room = np.full(len(sheet.boxes.lo), most)

    def leaf(k: int, m: int, pairs: np.ndarray) -> None:
        parts = sheet.refined(k, m)
        for lo, hi in zip(parts.lo[:, 0], parts.hi[:, 0], strict=True):
            proved, left = _halved(clearance, (lo, hi, pairs), least, most, 0.0, HALVES)
            if left is not None:
                refuse(sheet.time(k), *left)
            room[k] = min(room[k], proved)

    def refuse(t: float, lo: np.ndarray, hi: np.ndarray, pairs: np.ndarray) -> None:
        near = clearance.nearest((lo + hi) / 2, t, pairs)
        travel = float(np.max(clearance.reach[pairs] @ ((hi - lo) / 2)))
        beside = float(np.max(clearance.total[pairs])) * (least + clearance.doubt)
        found = (
            "nearer than the margin" if near.distance < near.margin
            else f"undecided to within {travel * 1e3:.2f} mm, with {beside * 1e3:.0f} mm for a following error of {least:g} rad on every joint"
        )  # fmt: skip
        raise SafetyStop(f"{what}: {near}: {found}; move the obstacle or the home posture, or plan a smaller or slower motion")

    _prove(clearance, sheet, room, least, most, leaf)
    return room


def _room(clearance: Clearance, q: np.ndarray, width: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P,) rad of room verified for each pair within `width` of q, and (P,) rad of room at q itself."""
    spare = clearance.distances(q, pairs.tolist()) - clearance.margin[pairs] - GJK
    total = clearance.total[pairs]
    # a pair that no joint moves is always apart or never; NaN is neither, and verifies nothing
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.where(total == 0, np.where(spare >= 0, np.inf, -np.inf), (spare - clearance.reach[pairs] @ width) / total)
        at = np.where(total == 0, inside, spare / total)
    return inside - clearance.doubt, at - clearance.doubt


def _halved(clearance: Clearance, box: Box, least: float, most: float, share: float, halves: int) -> tuple[float, Box | None]:
    """rad of room in a box, halved where too little is verified; and a part with too little, or left after `halves` steps."""
    todo, proved = [box], most
    for _ in range(halves):
        if not todo:
            return proved, None
        lo, hi, pairs = todo.pop()
        found, at = _room(clearance, (lo + hi) / 2, (hi - lo) / 2, pairs)
        good = found >= np.maximum(least, np.minimum(most, share * np.clip(at, 0.0, np.pi)))
        proved = min(proved, float(found[good].min(initial=most)))
        pairs, at = pairs[~good], at[~good]
        if not len(pairs):
            continue
        if not (at >= least).all():
            return proved, (lo, hi, pairs)
        j = int(np.argmax(clearance.reach[pairs].max(axis=0) * (hi - lo)))
        below, above = hi.copy(), lo.copy()
        below[j] = above[j] = (lo[j] + hi[j]) / 2
        todo += [(lo, below, pairs), (above, hi, pairs)]
    return proved, todo[-1] if todo else None


def _prove(
    clearance: Clearance,
    sheet: Sheet,
    room: np.ndarray,
    least: float,
    most: float,
    leaf: Callable[[int, int, np.ndarray], None],
) -> None:
    """From the largest boxes down, until each verifies SHARE of the room at its centre.

    `leaf(k, m, pairs)` decides the sheet's own boxes.
    """
    top = len(sheet.levels) - 1
    rows, stages = sheet.levels[top][2].lo.shape[:2]
    every = np.arange(len(clearance.pairs))
    todo = [(top, k, m, every) for k in range(rows) for m in range(stages)] if len(every) else []
    while todo:
        level, k, m, pairs = todo.pop()
        r, c, boxes = sheet.levels[level]
        low, high = boxes.lo[k, m, 0], boxes.hi[k, m, 0]
        found, at = _room(clearance, (low + high) / 2, (high - low) / 2, pairs)
        proved = found >= np.maximum(least, np.minimum(most, SHARE * at))
        if proved.any():
            part = room[k * r : (k + 1) * r]
            np.minimum(part, float(found[proved].min()), out=part)
        pairs = pairs[~proved]
        if not len(pairs):
            continue
        if level > 0 and r <= FEW_ROWS and (at[~proved] >= least).all():
            within, left = _halved(clearance, (low, high, pairs), least, most, SHARE, FEW_HALVES)
            if left is None:
                part = room[k * r : (k + 1) * r]
                np.minimum(part, within, out=part)
                continue
        if level == 0:
            leaf(k, m, pairs)
            continue
        finer, below, smaller = sheet.levels[level - 1]
        rows, stages = smaller.lo.shape[:2]
        todo += [
            (level - 1, a, b, pairs)
            for a in range(k * r // finer, min((k + 1) * r // finer, rows))
            for b in range(m * c // below, min((m + 1) * c // below, stages))
        ]
