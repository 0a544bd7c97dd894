"""A watcher's estimates for an arm at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.watch.events import Quantity
from calib.watch.load import JOINT_SECONDS, JOINTS_LEAST
from calib.watch.wear import JointFriction

_NUMBERS = {1: "the joint", 2: "both joints", 3: "three joints"}


@dataclass(frozen=True, slots=True)
class Declared:
    """The declared payload at the flange: kg, m in the last link's frame, and who declared it."""

    mass: float
    com: tuple[float, float, float]
    by: str


@dataclass(frozen=True)
class Picture:
    """A watcher's present estimates.

    nis is the normalised innovation squared over its degrees of freedom, averaged over recent motion: 1 where the filter is consistent,
    NaN before the first motion. moved (n,) is s of informative motion, seconds (n,) the part of it since the load was known, residual (n,)
    the unexplained N m RMS in that part, compared_from (n,) s since when it is compared with that of the first motion, NaN where it is not. claimed is the mass that the last load event reported, None where none did. hidden, kg, is the
    largest mass that static friction can hide in the present pose, None while the arm moves. broken: hardly any reading of the present
    motion could be used.
    """

    t: float
    payload: Quantity
    claimed: Quantity | None
    com: tuple[Quantity, Quantity, Quantity] | None
    settled: bool
    deciding: bool
    fits: bool | None
    friction: list[JointFriction]
    nis: float
    moved: np.ndarray
    seconds: np.ndarray
    residual: np.ndarray
    compared_from: np.ndarray
    hidden: float | None
    samples: int
    faults: dict[str, int]
    broken: bool = False

    def measured(self, j: int) -> JointFriction | None:
        """Friction of joint j; None where it has not moved, because its numbers are then those of the arm's file."""
        return self.friction[j] if self.moved[j] > 0 else None

    @property
    def sentence(self) -> str:
        """The state in words; nothing is claimed without motion."""
        if self.fits is False:
            return "the readings do not fit the arm: no claim"
        if self.broken and not self.settled:
            return "no claim: the readings are too broken to watch"
        if not np.isfinite(self.t):
            return "no claim: no reading could be used" if self.faults else "no claim: there were too few readings"
        if not np.any(self.moved > 0):
            hides = "" if self.hidden is None else f" up to {self.hidden:.2g} kg"
            return f"no claim without motion: at rest static friction hides{hides} at the flange"
        if not self.settled:
            least = min(JOINTS_LEAST, len(self.moved))
            if np.count_nonzero(self.moved >= JOINT_SECONDS) >= least:
                return "too little motion for a claim: the load is not yet certain"
            return f"too little motion for a claim: {_NUMBERS[least]} must move"
        load = self._load
        if self.broken:
            return f"no claim: the readings have become too broken to watch; before: {load}"
        if self.deciding:
            return f"the load has just changed: {load}, not yet decided"
        if self.hidden is not None:
            return f"standing, no claim without motion (static friction hides up to {self.hidden:.2g} kg); before: {load}"
        return load

    @property
    def _load(self) -> str:
        """What is at the flange; a reported load stays until its removal is reported."""
        if self.payload.value > 3 * self.payload.std:
            return f"{self.payload} at the flange"
        if self.claimed is not None:
            return f"{self.claimed} reported at the flange, no longer certain ({self.payload} now)"
        return "nothing at the flange"
