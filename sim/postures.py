"""Postures drawn over the whole range of an arm's joints."""

from __future__ import annotations

import numpy as np

from sim.arm import Arm

POSTURES = 200


def postures(arm: Arm, count: int = POSTURES) -> np.ndarray:
    """(count, n) rad drawn over the joint ranges, at most one turn each; the same postures at every call."""
    low, high = np.where(np.isfinite(arm.q_min), arm.q_min, -np.pi), np.where(np.isfinite(arm.q_max), arm.q_max, np.pi)
    middle, half = (low + high) / 2, np.minimum((high - low) / 2, np.pi)
    return np.asarray(middle + half * np.random.default_rng(0).uniform(-1, 1, (count, arm.n)))
