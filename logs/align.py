"""Align messages of several topics to the sample times; check their order and their sequence numbers."""

from __future__ import annotations

import numpy as np

from logs.damage import Damage
from logs.joint_topic import JointTopic
from logs.timing import unwrapped

INTERPOLATED = "readings on {} have their own stamps; they were interpolated on the device clock"


def time_order(stamp: np.ndarray, log: np.ndarray) -> np.ndarray | None:
    """Return the order of the log times, in which other readers return messages; None where the file's order is kept.

    It is kept where the log times, or the device stamps, never decrease: log times may come from a clock that was set.
    """
    if not np.any(np.diff(stamp) < 0) or not np.any(np.diff(log) < 0):
        return None
    return np.argsort(log, kind="stable")


def report_losses(stamp: np.ndarray, sequence: np.ndarray, states: JointTopic, damage: Damage) -> None:
    """Report missing messages, where the sequence numbers count messages (many writers leave them zero)."""
    steps = np.diff(sequence)
    if states.others or not len(steps) or np.any(steps < 1):
        return
    gaps = np.flatnonzero(steps > 1)
    if len(gaps):
        lost, first = int((steps[gaps] - 1).sum()), (int(stamp[gaps[0]]) - int(stamp[0])) * 1e-9
        damage.note(f"{lost} messages on {states.topic} are missing by their sequence numbers, first after {first:.4f} s")


def held(
    topic: JointTopic | None,
    stamp: np.ndarray,
    t: np.ndarray,
    n: int,
    fields: int,
    damage: Damage,
    between: tuple[int, ...] = (),
) -> list[np.ndarray]:
    """Return the last message at or before each sample, one (N, n) array per field; NaN before the first, and without a topic.

    Fields in `between` are readings with their own stamps. They are interpolated linearly, NaN after the last reading. Holding
    the last reading would make it old by half its period on average, which looks like a delay.
    """
    if topic is None:
        return [np.broadcast_to(np.float64(np.nan), (len(stamp), n))] * fields
    own = np.concatenate(topic.stamp)
    parts = [topic.joined(k) for k in range(fields)]
    if len(own) == len(stamp) and np.array_equal(own, stamp):
        return parts
    at, order = reading_times(own, int(stamp[0]), topic.topic, damage)
    out = []
    for k, part in enumerate(parts):
        if part.strides[0] and k in between and beside(at, t):
            damage.note(INTERPOLATED.format(topic.topic))
        out.append(at_samples(at, part, order, t, k in between))
    return out


def reading_times(own: np.ndarray, first: int, name: str, damage: Damage) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the times of readings, s after the stamp `first`, in increasing order, from their stamps `own` (ns).

    The second value gives the reading at each of these times; None where the readings already are in order.
    """
    at = unwrapped((own - first) * 1e-9, damage)
    if not np.any(np.diff(at) < 0):
        return at, None
    order = np.argsort(at, kind="stable")
    damage.note(f"messages on {name} are not in the order of their stamps; they were read in that order")
    return at[order], order


def beside(at: np.ndarray, t: np.ndarray) -> bool:
    """Whether readings at the times `at` have their own stamps, other than those of the samples `t`."""
    return bool(np.any(at[np.maximum(np.searchsorted(at, t, side="right") - 1, 0)] != t))


def at_samples(at: np.ndarray, part: np.ndarray, order: np.ndarray | None, t: np.ndarray, between: bool) -> np.ndarray:
    """Readings `part` at the sample times t, (N, n), as `held` describes; `at` and `order` come from `reading_times`."""
    if not part.strides[0]:
        return np.broadcast_to(np.float64(np.nan), (len(t), part.shape[1]))
    place = np.searchsorted(at, t, side="right") - 1
    now, after = np.maximum(place, 0), np.minimum(place + 1, len(part) - 1)
    if order is not None:
        now, after = order[now], order[after]
    value = np.array(part[now])
    value[place < 0] = np.nan
    if between:
        value += _share(at, place, t)[:, None] * (part[after] - value)
    return value


def _share(at: np.ndarray, place: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(N,) position of t between its reading and the next, 0 to 1; NaN after the last."""
    after = np.minimum(place + 1, len(at) - 1)
    step = at[after] - at[np.maximum(place, 0)]
    past = t - at[np.maximum(place, 0)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(past == 0, 0.0, np.where(step > 0, past / step, np.nan))
